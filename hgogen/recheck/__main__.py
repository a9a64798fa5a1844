"""Command `python -m recheck FILE`, which verifies a certificate with this folder and mpmath only."""

import argparse
import json
import os
import sys

from .file import FORMAT, VERSION
from .text import RecheckError
from .verification import Rechecked, load, recheck


def main(arguments: list[str] | None = None) -> int:
    """Verify the certificate file in the arguments and print the outcome of its claims, as text or JSON. Return the
    exit status: 0 if every claim stated as proved or refuted is verified, 1 if one is not or there is none, 2 if the
    file is no certificate."""
    parser = argparse.ArgumentParser(prog="recheck", description="Verify a certificate of hgogen again.")
    parser.add_argument("file", metavar="FILE", help="a certificate that hgogen check wrote")
    parser.add_argument("--json", action="store_true", help="print the result as JSON")
    parser.add_argument("--version", action="version", version=f"it reads {FORMAT}s of format version {VERSION}")
    options = parser.parse_args(arguments)
    try:
        result = recheck(load(options.file))
    except RecheckError as error:
        print(error, file=sys.stderr)
        return 2
    print(json.dumps(result.as_dict(), indent=2) if options.json else _text(result))
    try:
        result.demand()
    except RecheckError as error:
        print(error, file=sys.stderr)
        return 1
    return 0


def _text(result: Rechecked) -> str:
    head = f"{result.plant} in {result.form} form{f', {result.observer} observer' if result.observer else ''}"
    rows = (f"{row.found:8}  {row.verdict:8}  {row.id}: {row.sentence}" for row in result.rows)
    return "\n".join([head, f"model {result.model}", *rows, *result.remarks, result.count])


def _run() -> int:
    try:
        status = main()
        sys.stdout.flush()
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # Python flushes it once more at its end
        return 141  # 128 + SIGPIPE, as a shell has it
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return 130
    return status


if __name__ == "__main__":
    sys.exit(_run())

"""What a change of the house must not change, of every shipped model: two versions of the project, side by side.

    python tests/sides.py [REVISION] [--models a,b] [--sentences]

REVISION is a commit, by default HEAD: what lies in the folder now is compared with it. Compared are, for each model,
the answers of `hgogen check` and of its forms, and for each of its tunings the claims with their verdicts, the gains,
the certificate and the C in float and double without its comments, whose self-check holds recorded vectors. Sentences
(reasons, advice) may differ unless `--sentences` asks. Each difference is printed with its place; the exit status is 1
if there is one. The answers of a commit are stored in `build/sides`, so that only the first comparison asks for them.

Each version is asked in processes of its own, with its own package in front of the path, by what is public in it.
"""

import argparse
import hashlib
import json
import os
import re
import subprocess
import sys
import tarfile
import tempfile
from collections.abc import Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from io import BytesIO
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
STORE = ROOT / "build" / "sides"
SENTENCES = {  # keys of sentences, where their values are text
    *("advice", "claim", "conclusion", "digest", "fix", "headline", "hgogen", "known", "line", "note", "notes"),
    *("reason", "reference", "repairs", "where", "why"),
}
SHOWN = 100  # characters of a value that differs
COMMENT = re.compile(r"/\*.*?\*/", re.DOTALL)

# --- one version: run in processes whose path begins with its folder


def tunings(path: Path) -> list[str | None]:
    """The names of a model's tunings, and None for its own step."""
    import hgogen as hg

    model = hg.load(path)
    return [*([None] if model.has("step") else []), *model.tuning.tables]


def checked(path: Path) -> Any:
    """What `hgogen check --json` prints."""
    command = [sys.executable, "-m", "hgogen", "check", str(path), "--json"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return {"status": done.returncode, "answer": json.loads(done.stdout) if done.stdout else done.stderr}


def built(path: Path, tuning: str | None) -> Any:
    """What is claimed of a tuning's step, its certificate and its C; of one that is refused, the kind of refusal."""
    import hgogen as hg

    try:
        step = hg.load(path).step(tuning)
    except hg.HgogenError as error:
        return {"refused": type(error).__name__, "reason": str(error)}
    observer = step.observer
    try:
        certificate: Any = hg.certificate(observer.form, observer.checks, observer.name)
    except hg.HgogenError as error:
        certificate = {"refused": type(error).__name__, "reason": str(error)}
    return {
        "observer": observer.name,
        "dt": step.dt,
        "gains": {field.name: list(field.initial) for field in observer.gains},
        "checks": {check.id: {"verdict": str(check.verdict), "reason": check.reason} for check in observer.checks},
        "certificate": certificate,
        "c": {real: sources(hg.targets.c99(step, real=real)) for real in ("float", "double")},
    }


def sources(files: Mapping[str, str]) -> dict[str, list[str]]:
    """The lines of C that are no comments, by file."""
    return {
        name: [line.rstrip() for line in COMMENT.sub("", text).splitlines() if line.strip()]
        for name, text in files.items()
    }


def answered(job: tuple[str, str | None, bool]) -> Any:
    path, tuning, whole = job
    return json.loads(json.dumps(checked(Path(path)) if whole else built(Path(path), tuning), default=str))


def answers(folder: Path, models: list[str]) -> dict[str, Any]:
    """Those of one version, by model and tuning; `hgogen` is that of `folder`."""
    import hgogen as hg

    if not Path(str(hg.__file__)).is_relative_to(folder):
        raise SystemExit(f"the package is {hg.__file__}, which is not below {folder}")
    paths = [path for path in sorted((folder / "models").glob("*.[pt]*")) if not models or path.stem in models]
    jobs: dict[str, tuple[str, str | None, bool]] = {}
    for path in paths:
        jobs[path.stem] = (str(path), None, True)
        jobs |= {f"{path.stem} {name or 'step()'}": (str(path), name, False) for name in tunings(path)}
    with ProcessPoolExecutor() as pool:
        return dict(zip(jobs, pool.map(answered, jobs.values()), strict=True))


# --- two versions


class Unknown(Exception):
    """A commit or a model that is not there, as a sentence."""


def asked(folder: Path, models: list[str]) -> dict[str, Any]:
    """The answers of the version in a folder, from a process of its own."""
    command = [sys.executable, str(Path(__file__).resolve()), "--answers", str(folder), "--models", ",".join(models)]
    environment = {**os.environ, "PYTHONPATH": str(folder)}
    with tempfile.TemporaryDirectory() as empty:
        done = subprocess.run(command, cwd=empty, env=environment, stdout=subprocess.PIPE, check=True)
    text = done.stdout.decode().replace(str(folder), "")
    by_model: dict[str, Any] = json.loads(text)
    return by_model


def before(revision: str, models: list[str]) -> dict[str, Any]:
    """The answers of a commit, stored by its hash."""
    try:
        commit = _git("rev-parse", "--verify", "--quiet", f"{revision}^{{commit}}").decode().strip()
    except subprocess.CalledProcessError:
        raise Unknown(f"{revision} is no commit of {ROOT}; name one, such as HEAD~1") from None
    key = hashlib.sha256(Path(__file__).read_bytes() + ",".join(models).encode()).hexdigest()[:12]
    store = STORE / f"{commit}-{key}.json"
    if not store.exists():
        with tempfile.TemporaryDirectory() as folder:
            with tarfile.open(fileobj=BytesIO(_git("archive", commit))) as archive:
                archive.extractall(folder)
            by_model = asked(Path(folder).resolve(), models)
        store.parent.mkdir(parents=True, exist_ok=True)
        store.write_text(json.dumps(by_model))
    stored: dict[str, Any] = json.loads(store.read_text())
    return stored


def _git(*arguments: str) -> bytes:
    return subprocess.run(["git", "-C", str(ROOT), *arguments], capture_output=True, check=True).stdout


def differences(one: Any, other: Any, sentences: bool, place: str = "") -> Iterator[str]:
    """Where two values differ, each by its place."""
    if isinstance(one, dict) and isinstance(other, dict):
        for key in [*one, *(key for key in other if key not in one)]:
            if key in one and key in other:
                if sentences or key not in SENTENCES or not _text(one[key]):
                    yield from differences(one[key], other[key], sentences, f"{place}: {key}" if place else key)
            else:
                yield f"{place}: {key} is {'new' if key in other else 'gone'}"
    elif isinstance(one, list) and isinstance(other, list) and len(one) == len(other):
        for k, pair in enumerate(zip(one, other, strict=True)):
            yield from differences(*pair, sentences, f"{place}[{k}]")
    elif one != other:
        yield f"{place}\n    - {str(one)[:SHOWN]}\n    + {str(other)[:SHOWN]}"


def _text(value: Any) -> bool:
    return isinstance(value, str) or (isinstance(value, list) and all(isinstance(each, str) for each in value))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("revision", nargs="?", default="HEAD")
    parser.add_argument("--models", default="", help="their names, with commas between; by default all")
    parser.add_argument("--sentences", action="store_true", help="compare reasons and advice as well")
    parser.add_argument("--answers", metavar="FOLDER", help="print the answers of the version in a folder, as JSON")
    options = parser.parse_args()
    models = [name for name in options.models.split(",") if name]
    there = {path.stem for path in (ROOT / "models").glob("*.[pt]*")}
    if missing := sorted({*models} - there):
        parser.error(f"there is no model {', '.join(missing)}; the models are {', '.join(sorted(there))}")
    if options.answers:
        print(json.dumps(answers(Path(options.answers), models)))
        return
    try:
        old, new = before(options.revision, models), asked(ROOT, models)
    except Unknown as error:
        parser.error(str(error))
    lines = list(differences(old, new, options.sentences))
    print("\n".join([*lines, f"{len(new)} answers, {len(lines)} differences from {options.revision}"]))
    raise SystemExit(bool(lines))


if __name__ == "__main__":
    main()

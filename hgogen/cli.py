"""The entry point of the command `hgogen`, with its handling of signals and output from the first import on.

Ctrl-C ends it without a traceback, by the signal itself, so that a shell's loop around it ends as well. The standard
output is for results alone: output of a model, a library or a process that they start to descriptor 1 goes to the
standard error stream.
"""

import _signal as signal  # type: ignore[import-not-found]  # `signal` makes enums of it, which takes milliseconds


def main() -> None:
    """Run the command line of this process."""
    interruptible = signal.getsignal(signal.SIGINT) is signal.default_int_handler  # or its parent ignores Ctrl-C
    if interruptible:
        signal.signal(signal.SIGINT, signal.SIG_DFL)  # there is nothing to clean up yet
    from hgogen.commands import output
    from hgogen.commands.app import app

    output.set_apart()
    status: object = output.INTERRUPTED
    try:
        app()
    except SystemExit as ended:
        status = output.flushed(ended.code)
    except OSError as error:  # as of a full disk under the help
        output.note(str(error))
        status = output.flushed(2)
    except KeyboardInterrupt:
        pass
    if interruptible:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
        if status == output.INTERRUPTED:
            signal.raise_signal(signal.SIGINT)
    raise SystemExit(status)


def __getattr__(name: str) -> object:
    """Return `app`, the command line as an object for tests and other programs in Python; it is imported at its first
    use."""
    if name != "app":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from hgogen.commands.app import app

    return app


if __name__ == "__main__":
    main()

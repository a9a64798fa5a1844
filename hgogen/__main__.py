"""`python -m hgogen`, the command `hgogen` where no script is installed."""

from hgogen.cli import main

if __name__ == "__main__":
    main()

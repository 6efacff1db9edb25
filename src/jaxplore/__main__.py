"""The command line as a program: `jaxplore`, or `python -m jaxplore`."""

import sys

from jaxplore._exit import INTERRUPTED


def main() -> None:
    """Run the command line."""
    # Ctrl-C during this import has nothing to save.
    try:
        from jaxplore import cli
    except KeyboardInterrupt:
        print("jaxplore: interrupted", file=sys.stderr)
        sys.exit(INTERRUPTED)
    cli.main()


if __name__ == "__main__":
    main()

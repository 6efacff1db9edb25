"""The command line as a program: `jaxplore`, or `python -m jaxplore`."""

from jaxplore._signals import end_at_once


def main() -> None:
    """Run the command line."""
    # Until a command has imported what it runs, and again while Python shuts down.
    end_at_once()
    from jaxplore import cli
    from jaxplore.cli._streams import open_streams

    open_streams()
    cli.main()


if __name__ == "__main__":
    main()

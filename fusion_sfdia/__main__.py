"""python -m fusion_sfdia: the command line."""

import signal


def main() -> int:
    """Run the command line of this process; return its exit code."""
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.SIG_DFL)  # until it is handled there is nothing to end in order
    from fusion_sfdia.cli.main import main as command

    return command()


if __name__ == "__main__":
    raise SystemExit(main())

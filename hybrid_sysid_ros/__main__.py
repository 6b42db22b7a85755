"""The command line as a program, which can be interrupted from the first of its imports on."""

from __future__ import annotations

from hybrid_sysid_ros.support import interruption


def main() -> None:
    """Run a command, see :func:`hybrid_sysid_ros.commands.app.main`."""
    interruption.install()
    from hybrid_sysid_ros.commands import app

    app.main()


if __name__ == "__main__":
    main()

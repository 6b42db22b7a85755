"""What a user can cause: an error, and an early end."""


class UserError(Exception):
    """What is wrong, where (file, topic, parameter, sample) and what to do, in one line.

    The command line prints it and exits with status 2.
    """


class Interrupted(Exception):
    """The user ended a command early (Ctrl-C). The text, in one line or "", says what is kept and how to go on.

    The command line prints it and exits with status 130, as shells do for SIGINT (128 + 2).
    """

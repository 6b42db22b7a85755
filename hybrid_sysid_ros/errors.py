"""The one error a user can cause."""


class UserError(Exception):
    """What is wrong, where (file, topic, parameter, sample) and what to do, in one line.

    The command line prints it and exits with status 2.
    """

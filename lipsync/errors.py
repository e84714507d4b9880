"""What the user can mend."""


class UserError(ValueError):
    """A mistake of the user's: the text says in one line what, where, and what to do.

    The command line prints it without a traceback; everything else is a fault of ours.
    """

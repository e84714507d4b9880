"""What the user can mend."""

import reprlib

_SHORT = reprlib.Repr()
_SHORT.maxstring = _SHORT.maxother = _SHORT.maxlong = 60
_SHORT.maxlevel = 2
_SHORT.maxdict = _SHORT.maxlist = _SHORT.maxtuple = 3


class UserError(ValueError):
    """A mistake of the user's: the text says in one line what, where, and what to do.

    The command line prints it without a traceback; everything else is a fault of ours.
    """


def shown(value: object) -> str:
    """A value from somebody's file as a message may show it: short, whatever it holds."""
    return _SHORT.repr(value)

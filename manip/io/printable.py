"""Text from files, made safe to print."""

MOST = 5000
"""Characters of a text that are shown."""


def printable(text: str) -> str:
    """The start of a text, with control and other invisible characters escaped.

    A policy card may hold escape sequences, which a terminal would obey, and line
    breaks, which would break a table.
    """
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text[:MOST])

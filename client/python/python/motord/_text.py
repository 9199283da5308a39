"""Text of files and of other processes, for exceptions and for a terminal."""

LENGTH_MAX = 2000
"""Characters of a sentence about a file."""


def printable(text: str) -> str:
    """Spells out each control, format and bidirectional character, as \\u{1b}, and cuts off what is longer than LENGTH_MAX."""
    shown = text if len(text) <= LENGTH_MAX else f"{text[:LENGTH_MAX]}…"
    return shown if shown.isprintable() else "".join(map(_spelled, shown))


def lines(text: str) -> str:
    """Spells out a text of several lines."""
    return "\n".join(map(printable, text.split("\n")))


def _spelled(letter: str) -> str:
    return letter if letter.isprintable() else f"\\u{{{ord(letter):x}}}"

"""Files and texts that another user or program may have made: regular files up to a size, and text for exceptions and terminals."""

import os
import stat
from typing import BinaryIO

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


class FileError(Exception):
    """A file cannot be read. Its text says why."""


def open_regular(path: str, bytes_max: int) -> BinaryIO:
    """Opens a regular file of at most bytes_max bytes. Waits for no pipe and no device. Raises FileError."""
    try:
        # Before the file is opened: to open a device may change it.
        _check(os.stat(path), bytes_max)
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except FileNotFoundError:
        raise FileError("there is no such file") from None
    except (OSError, ValueError) as error:
        # ValueError: a path with a zero byte.
        raise FileError(getattr(error, "strerror", None) or str(error)) from error
    file = os.fdopen(descriptor, "rb")
    try:
        _check(os.fstat(descriptor), bytes_max)
    except FileError:
        file.close()
        raise
    return file


def check_regular(path: str, bytes_max: int) -> None:
    """Checks a file that another library reads. Raises FileError."""
    open_regular(path, bytes_max).close()


def _check(status: os.stat_result, bytes_max: int) -> None:
    if not stat.S_ISREG(status.st_mode):
        raise FileError("it is no regular file: save the data to a file first")
    if status.st_size > bytes_max:
        raise FileError(f"it has {status.st_size >> 20} MiB; at most {bytes_max >> 20} MiB are read")

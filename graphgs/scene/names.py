"""Photo names: POSIX paths relative to a data folder. Names read from files must not lead out of it."""

import posixpath
import re

import numpy as np


def inside(name: str) -> str | None:
    """`name` in its plain form ("./a//b.jpg" is "a/b.jpg"), or None if it is empty, absolute, leads out of the
    folder, or holds characters that no name on paper has (control characters, undecodable bytes)."""
    plain = posixpath.normpath(name.replace("\\", "/")) if name else ""
    if plain in ("", ".", "..") or plain.startswith(("/", "../")) or plain[1:2] == ":":
        return None
    return plain if printable(plain) else None


def printable(name: str) -> bool:
    """True if `name` can be shown, and written to line-based lists: no control characters, no undecodable bytes."""
    return all(ord(c) >= 32 and ord(c) != 127 and not 0xD800 <= ord(c) <= 0xDFFF for c in name)


def as_counted(names: tuple[str, ...]) -> np.ndarray:
    """[N] int: the names sorted as people count, 2 before 10."""
    return _order(names, lambda digits: (0, int(digits), ""))


def as_text(names: tuple[str, ...]) -> np.ndarray:
    """[N] int: the names sorted as text without leading zeros sorts, 10 before 2."""
    return _order(names, lambda digits: (1, 0, str(int(digits))))


def _order(names: tuple[str, ...], number) -> np.ndarray:
    def key(k: int) -> list[tuple[int, int, str]]:
        parts = re.split(r"([0-9]+)", names[k])
        return [number(part) if i % 2 else (1, 0, part) for i, part in enumerate(parts)]

    return np.array(sorted(range(len(names)), key=key), dtype=np.int64)

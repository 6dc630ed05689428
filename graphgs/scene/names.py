"""Photo names: POSIX paths relative to a data folder. Names read from files must not lead out of it."""

import posixpath


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

"""File names for pictures of photos: inside their folder, writable everywhere, unique."""

import re
from collections import Counter
from hashlib import sha256
from pathlib import PurePosixPath

# Names that are devices on Windows, whatever their suffix.
RESERVED = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\..*)?", re.IGNORECASE)
MAX_PART = 120  # characters of a path's part, so that a suffix still fits into 255 bytes of UTF-8


def picture_names(names: tuple[str, ...]) -> tuple[str, ...]:
    """One POSIX path per photo, its name without the extension ("left/0001.jpg" is "left/0001").

    Photos that then share a path, also on a file system that ignores case, all keep their extension; those still alike
    after characters were replaced get a piece of the name's hash. The result does not depend on the order.
    """
    safe = {name: _safe(str(PurePosixPath(name).with_suffix(""))) for name in names}
    safe = _told_apart(safe, lambda name: _safe(name))
    safe = _told_apart(safe, lambda name: f"{_safe(name)}-{_hash(name)}")
    return tuple(safe[name] for name in names)


def _told_apart(safe: dict[str, str], longer) -> dict[str, str]:
    """The names that clash replaced by a longer form."""
    uses = Counter(path.casefold() for path in safe.values())
    return {name: longer(name) if uses[path.casefold()] > 1 else path for name, path in safe.items()}


def _safe(path: str) -> str:
    parts = [part for part in path.replace("\\", "/").split("/") if part not in ("", ".")]
    return "/".join(_safe_part(part) for part in parts) or "_"


def _safe_part(part: str) -> str:
    """Letters, digits, and ._- and blanks inside; anything else is an underscore. Never "..", hidden, or a device."""
    clean = "".join(c if c.isalnum() or c in "._- " else "_" for c in part).strip(" .")
    if len(clean) > MAX_PART or len(clean.encode()) > 2 * MAX_PART:
        clean = f"{clean[: MAX_PART // 3]}-{_hash(part)}"
    return f"_{clean}" if not clean or RESERVED.fullmatch(clean) else clean


def _hash(text: str) -> str:
    return sha256(text.encode("utf-8", "surrogatepass")).hexdigest()[:8]

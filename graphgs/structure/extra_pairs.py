"""Pairs a user asks for: a text file with two photo names a line."""

from pathlib import Path

import numpy as np

from graphgs.errors import UsageError


def read_extra_pairs(
    file: str | Path | None,
    names: tuple[str, ...],  # [N] photos
) -> np.ndarray:
    """[Q, 2] int into `names`, i < j, unique, sorted; empty without a file.

    A line holds two names of photos, separated by blanks or a tab; # begins a comment. Names with blanks are put in
    double quotes. Raises UsageError that names the line for anything else."""
    if file is None:
        return np.zeros((0, 2), np.int64)
    try:
        text = Path(file).read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "not a text file"
        raise UsageError(f"--pairs-extra {file}: cannot be read ({reason})", hint="check the path") from error
    index = {name: k for k, name in enumerate(names)}
    pairs = set()
    for number, line in enumerate(text.splitlines(), start=1):
        found = _names_in(line)
        if not found:
            continue
        where = f"--pairs-extra {file}, line {number}"
        if len(found) != 2:
            raise UsageError(
                f"{where}: expected two photo names, got {len(found)}",
                hint='one pair a line, as in: a.jpg b.jpg; names with blanks in double quotes: "a 1.jpg" b.jpg',
            )
        unknown = [name for name in found if name not in index]
        if unknown:
            raise UsageError(
                f"{where}: there is no photo '{unknown[0]}'", hint=f"names are as in the input, for example {names[0]}"
            )
        first, second = sorted(index[name] for name in found)
        if first == second:
            raise UsageError(f"{where}: '{found[0]}' is paired with itself", hint="name two different photos")
        pairs.add((first, second))
    return np.array(sorted(pairs), dtype=np.int64).reshape(-1, 2)


def _names_in(line: str) -> list[str]:
    """The words of a line, up to a # at the beginning of a word; double quotes hold a word together."""
    words = []
    rest = line.strip()
    while rest and not rest.startswith("#"):
        if rest.startswith('"') and '"' in rest[1:]:
            word, rest = rest[1:].split('"', 1)
        else:
            word, _, rest = rest.replace("\t", " ").partition(" ")
        words.append(word)
        rest = rest.strip()
    return words

"""What the code says of decisions can be read."""

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def test_every_decision_that_is_named_exists():
    there = {path.name[:4] for path in (ROOT / "docs" / "decisions").glob("*.md")}
    sources = [path for top in ("graphgs", "kernels", "tests", "bench", "docs") for path in (ROOT / top).rglob("*")]
    named = {
        (match.group(1), str(path.relative_to(ROOT)))
        for path in sources
        if path.suffix in (".py", ".md")
        for match in re.finditer(r"decisions/(\d{4})", path.read_text(encoding="utf-8"))
    }
    assert named, "nothing names a decision: the pattern is out of date"
    assert [(number, path) for number, path in sorted(named) if number not in there] == []

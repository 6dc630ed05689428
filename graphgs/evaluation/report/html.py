"""HTML that is safe by construction: plain strings are escaped, only `Markup` passes through as it is."""

import html
import re
from collections.abc import Iterable

VOID = {"img", "meta", "br", "hr", "input", "col"}
# Control characters, lone surrogates (undecodable bytes of a name), text-direction overrides: shown, not obeyed.
_UNSEEN = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]")


class Markup(str):
    """Text that is already HTML."""

    __slots__ = ()


def escape(text: object) -> Markup:
    """Any value as HTML text or attribute value."""
    if isinstance(text, Markup):
        return text
    return Markup(html.escape(_UNSEEN.sub(lambda m: f"\\u{ord(m[0]):04x}", str(text))))


def join(*children: object) -> Markup:
    """Children one after the other: strings escaped, lists flattened, None left out."""
    parts = []
    for child in children:
        if child is None:
            continue
        nested = isinstance(child, Iterable) and not isinstance(child, str)
        parts.append(join(*child) if nested else escape(child))
    return Markup("".join(parts))


def element(name: str, /, *children: object, **attributes: object) -> Markup:
    """<name attributes>children</name>. `class_` is class, `stroke_width` is stroke-width; None and False leave an
    attribute out, True writes its bare name."""
    written = [f"<{name}"]
    for key, value in attributes.items():
        if value is None or value is False:
            continue
        key = key.rstrip("_").replace("_", "-")
        written.append(f" {key}" if value is True else f' {key}="{escape(value)}"')
    written.append(">")
    if name in VOID:
        return Markup("".join(written))
    return Markup("".join(written) + join(*children) + f"</{name}>")


def table(
    head: Iterable[str],
    rows: Iterable[Iterable[object]],
    *,
    numeric: Iterable[int] = (),  # columns set flush right
    class_: str | None = None,
) -> Markup:
    """A table that scrolls inside its own frame when the page is narrow."""
    numeric = set(numeric)

    def cells(tag: str, row: Iterable[object]) -> Markup:
        return join(*(element(tag, cell, class_="num" if k in numeric else None) for k, cell in enumerate(row)))

    body = [element("tr", cells("td", row)) for row in rows]
    whole = element("table", element("thead", element("tr", cells("th", head))), element("tbody", body), class_=class_)
    return element("div", whole, class_="scroll")

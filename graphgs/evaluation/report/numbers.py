"""Numbers as people read them."""

import math


def count(value: int) -> str:
    """12345 -> 12,345."""
    return f"{int(value):,}"


def short(value: float) -> str:
    """An axis label: 1500 -> 1.5k, 2e6 -> 2M, 0.25 -> 0.25."""
    for limit, suffix in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if abs(value) >= limit * 0.9999:
            return f"{value / limit:.4g}{suffix}"
    return f"{value:.4g}"


def percent(part: float, whole: float) -> str:
    """Share of a whole: 12.3 %, < 0.1 %."""
    if whole <= 0:
        return "–"
    share = 100.0 * part / whole
    if 0 < share < 0.1:
        return "< 0.1 %"
    return f"{share:.0f} %" if share >= 99.95 or share == 0 else f"{share:.1f} %"


def seconds(value: float) -> str:
    """4.2 s, 8 min 12 s, 3 h 05 min."""
    if value < 9.95:
        return f"{value:.1f} s"
    whole = round(value)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60:02d} s"
    minutes = round(value / 60)
    return f"{minutes // 60} h {minutes % 60:02d} min"


def size(value: int) -> str:
    """Bytes as MB or GB (powers of ten)."""
    return f"{value / 1e9:.2f} GB" if value >= 1e9 else f"{value / 1e6:.0f} MB"


def nice_step(span: float, *, count: int) -> float:
    """The step 1, 2 or 5 times a power of ten that divides `span` into about `count` parts."""
    if not (span > 0 and math.isfinite(span)):
        return 1.0
    raw = span / count
    power = 10.0 ** math.floor(math.log10(raw))
    return power * min((1.0, 2.0, 5.0, 10.0), key=lambda m: abs(math.log(m * power / raw)))


def ticks(low: float, high: float, *, count: int = 5, integer: bool = False) -> list[float]:
    """Round numbers inside [low, high]; one that is a hundredth of a step outside still counts."""
    step = nice_step(high - low, count=count)
    if integer:
        step = max(1.0, round(step))
    first, last = math.ceil(low / step - 0.01), math.floor(high / step + 0.01)
    return [k * step for k in range(first, last + 1)]

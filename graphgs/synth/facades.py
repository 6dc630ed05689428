"""House fronts: bricks, plaster or panels, windows, doors, shops, signs. Each is painted from its own seed."""

import numpy as np

from graphgs.synth.canvas import Canvas, masonry_color, random_color, random_word

STOREY = 3.0  # [m]
GROUND_FLOOR = 3.4  # [m]


def facade(rng: np.random.Generator, width: float, height: float, *, texels_per_m: float) -> np.ndarray:
    """[H, W, 3] uint8 front of a house, width x height metres."""
    wall = Canvas(rng, width, height, texels_per_m=texels_per_m, color=masonry_color(rng))
    _masonry(wall)
    trim = random_color(rng, (0.0, 0.2), (0.75, 0.95))
    storeys = max(1, int((height - GROUND_FLOOR - 0.5) // STOREY))
    columns = max(1, int(width // rng.uniform(2.1, 3.2)))
    window = (rng.uniform(0.9, 1.3), rng.uniform(1.3, 1.9))
    for storey in range(storeys):
        floor = height - GROUND_FLOOR - STOREY * storey
        if rng.uniform() < 0.5:
            wall.rect(0, floor - 0.12, width, 0.18, trim * rng.uniform(0.75, 1.0))
        for column in range(columns):
            if rng.uniform() < 0.12:
                continue
            x = (column + 0.5) * width / columns - window[0] / 2 + rng.uniform(-0.15, 0.15)
            _window(wall, x, floor - 0.75 - window[1], *window, trim)
    _ground_floor(wall, trim)
    for _ in range(rng.integers(2, 5)):
        _attachment(wall, storeys)
    wall.rect(0, 0, width, rng.uniform(0.25, 0.5), trim * 0.85)
    wall.fade(1.0, 0.94)
    return wall.image()


def blank_wall(rng: np.random.Generator, width: float, height: float, *, texels_per_m: float) -> np.ndarray:
    """[H, W, 3] uint8 side of a house: masonry, stains, a vent or two."""
    wall = Canvas(rng, width, height, texels_per_m=texels_per_m, color=masonry_color(rng))
    _masonry(wall)
    for _ in range(int(width * height / 12)):
        x, y = rng.uniform(0, width), rng.uniform(0, height)
        wall.rect(x, y, rng.uniform(0.3, 1.0), rng.uniform(0.3, 1.0), random_color(rng, (0.0, 0.4), (0.2, 0.8)))
    return wall.image()


def sign(rng: np.random.Generator, width: float, height: float, *, texels_per_m: float) -> np.ndarray:
    """[H, W, 3] uint8 board with letters and a symbol."""
    board = Canvas(rng, width, height, texels_per_m=texels_per_m, color=random_color(rng, (0.5, 0.9), (0.5, 0.9)))
    ink = 255.0 - board.pixels[0, 0]
    board.rect(0.06 * width, 0.06 * height, 0.88 * width, 0.88 * height, 0.85 * board.pixels[0, 0])
    size = min(0.5 * height, 0.8 * width)  # of a letter; it is 0.8 as wide as high, gap included
    letters = max(1, int(0.8 * width / (0.8 * size)))
    board.text(random_word(rng, letters), 0.1 * width, 0.7 * height, size, ink)
    board.ellipse(rng.uniform(0.2, 0.8) * width, 0.85 * height, 0.08 * width, 0.07 * height, ink)
    return board.image()


def _masonry(wall: Canvas) -> None:
    rng = wall.rng
    style = rng.integers(3)
    if style == 0:
        wall.bricks(0, 0, wall.width, wall.height, brick=(rng.uniform(0.4, 0.6), rng.uniform(0.16, 0.22)), jitter=0.15)
    elif style == 1:
        size = (rng.uniform(0.9, 1.6), rng.uniform(0.5, 0.8))
        wall.bricks(0, 0, wall.width, wall.height, brick=size, jitter=0.13)
    else:
        wall.stain(0.10, size=0.9)
    wall.stain(0.12, size=3.0, octaves=6)


def _window(wall: Canvas, x: float, y: float, width: float, height: float, trim: np.ndarray) -> None:
    rng = wall.rng
    frame = 0.09
    wall.rect(x - frame, y - frame, width + 2 * frame, height + 2 * frame, trim)
    wall.rect(x - 0.2, y + height + frame, width + 0.4, 0.12, 0.8 * trim)
    glass = random_color(rng, (0.1, 0.4), (0.15, 0.45))
    wall.rect(x, y, width, height, glass)
    if rng.uniform() < 0.6:  # something of the sky or the other side in the pane
        cut = np.sort(rng.uniform(0, 1, 3)) * height
        wall.polygon([(x, y), (x + width, y), (x + width, y + cut[0]), (x, y + cut[2])], 1.5 * glass + 20)
    if rng.uniform() < 0.5:
        curtain = random_color(rng, (0.0, 0.6), (0.5, 0.9))
        side = rng.uniform(0.15, 0.4) * width
        wall.rect(x, y, side, height, curtain)
        if rng.uniform() < 0.6:
            wall.rect(x + width - side, y, side, height, curtain * 0.95)
    if rng.uniform() < 0.3:
        wall.rect(x, y, width, rng.uniform(0.2, 0.7) * height, random_color(rng, (0.0, 0.4), (0.5, 0.85)))
    wall.rect(x + width * rng.choice([0.33, 0.5, 0.67]) - 0.03, y, 0.06, height, trim)
    wall.rect(x, y + height * rng.uniform(0.3, 0.7), width, 0.06, trim)
    if rng.uniform() < 0.3:
        shutter = random_color(rng, (0.3, 0.8), (0.3, 0.6))
        for left in (x - 0.55, x + width + 0.1):
            wall.rect(left, y, 0.45, height, shutter)
            wall.rect(left + 0.08, y + 0.1, 0.29, 0.4 * height, shutter * 0.75)
    if rng.uniform() < 0.3:
        _flowers(wall, x, y + height - 0.12, width)


def _flowers(wall: Canvas, x: float, y: float, width: float) -> None:
    rng = wall.rng
    wall.rect(x, y, width, 0.3, random_color(rng, (0.3, 0.6), (0.25, 0.5)))
    for _ in range(8):
        blossom = random_color(rng, (0.6, 0.9), (0.6, 0.95)) if rng.uniform() < 0.5 else np.array([50.0, 110.0, 45.0])
        wall.ellipse(x + rng.uniform(0, width), y + rng.uniform(-0.1, 0.1), 0.1, 0.08, blossom)


def _ground_floor(wall: Canvas, trim: np.ndarray) -> None:
    rng = wall.rng
    top = wall.height - GROUND_FLOOR
    if rng.uniform() < 0.6:
        wall.rect(0, top, wall.width, GROUND_FLOOR, 0.85 * masonry_color(rng))
        wall.bricks(0, top, wall.width, GROUND_FLOOR, brick=(0.9, 0.45), jitter=0.14)
    x = rng.uniform(0.3, 0.8)
    while x < wall.width - 1.4:
        kind = rng.integers(3)
        if kind == 0:
            _door(wall, x, trim)
            x += 1.1 + rng.uniform(0.4, 1.2)
        elif kind == 1 and wall.width - x > 3.2:
            span = min(wall.width - x - 0.3, rng.uniform(2.6, 4.2))
            _shop(wall, x, span, trim)
            x += span + rng.uniform(0.4, 1.0)
        else:
            _window(wall, x, wall.height - 2.4, 1.1, 1.3, trim)
            x += 1.1 + rng.uniform(0.6, 1.4)
    wall.rect(0, wall.height - 0.35, wall.width, 0.35, random_color(rng, (0.0, 0.2), (0.25, 0.45)))


def _door(wall: Canvas, x: float, trim: np.ndarray) -> None:
    rng = wall.rng
    bottom = wall.height
    paint = random_color(rng, (0.4, 0.9), (0.25, 0.65))
    wall.rect(x - 0.12, bottom - 2.5, 1.24, 2.5, trim)
    wall.rect(x, bottom - 2.35, 1.0, 2.35, paint)
    wall.rect(x + 0.12, bottom - 2.25, 0.76, 0.4, random_color(rng, (0.0, 0.3), (0.5, 0.8)))
    for row in range(3):
        wall.rect(x + 0.14, bottom - 1.7 + 0.55 * row, 0.3, 0.42, paint * 0.7)
        wall.rect(x + 0.56, bottom - 1.7 + 0.55 * row, 0.3, 0.42, paint * 0.78)
    wall.ellipse(x + 0.9, bottom - 1.1, 0.05, 0.05, (230, 210, 120))
    wall.rect(x + 1.2, bottom - 2.0, 0.3, 0.22, (235, 235, 225))
    wall.text(random_word(rng, 2), x + 1.23, bottom - 1.82, 0.16, (30, 30, 60))


def _shop(wall: Canvas, x: float, span: float, trim: np.ndarray) -> None:
    rng = wall.rng
    bottom = wall.height
    board = random_color(rng, (0.5, 0.95), (0.35, 0.85))
    wall.rect(x, bottom - 3.2, span, 0.65, board)
    wall.text(random_word(rng, int((span - 0.2) / 0.34)), x + 0.15, bottom - 2.68, 0.42, 255.0 - board)
    wall.rect(x, bottom - 2.5, span, 2.0, trim * 0.7)
    wall.rect(x + 0.1, bottom - 2.4, span - 0.2, 1.8, random_color(rng, (0.1, 0.3), (0.2, 0.4)))
    for _ in range(int(4 * span)):  # the window display
        left = x + 0.15 + rng.uniform(0, span - 0.9)
        width, height = rng.uniform(0.15, 0.6), rng.uniform(0.15, 0.9)
        wall.rect(left, bottom - 0.6 - height, width, height, random_color(rng, (0.2, 0.9), (0.4, 0.95)))


def _attachment(wall: Canvas, storeys: int) -> None:
    """Something that only this house has: a poster, a drain pipe, a painted mark."""
    rng = wall.rng
    x = rng.uniform(0, max(0.1, wall.width - 1.5))
    kind = rng.integers(3)
    if kind == 0:
        y = wall.height - rng.uniform(1.8, min(wall.height, GROUND_FLOOR + 0.6 * STOREY * storeys))
        width, height = rng.uniform(0.6, 1.5), rng.uniform(0.6, 1.3)
        paper = random_color(rng, (0.2, 0.9), (0.6, 0.95))
        wall.rect(x, y, width, height, paper)
        wall.text(random_word(rng, 3), x + 0.08 * width, y + 0.4 * height, 0.3 * width, 255.0 - paper)
        wall.polygon(
            np.column_stack([x + width * rng.uniform(0, 1, 4), y + height * rng.uniform(0.5, 1, 4)]), paper / 2
        )
    elif kind == 1:
        wall.rect(x, 0.4, 0.12, wall.height, random_color(rng, (0.0, 0.2), (0.25, 0.6)))
    else:
        steps = np.cumsum(rng.uniform(-0.5, 0.5, (6, 2)) + [0.25, 0.0], axis=0)
        wall.line(steps + [x, wall.height - 1.6], 0.08, random_color(rng, (0.5, 0.9), (0.3, 0.9)))

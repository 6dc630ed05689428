"""Picture files as data: URIs, small enough for a page."""

import base64
from pathlib import Path

import cv2
import numpy as np

MAX_SIDE = 960  # px
JPEG_QUALITY = 85


def data_uri(path: Path) -> tuple[str, int, int] | None:
    """(JPEG data: URI, width, height), downscaled to MAX_SIDE; None when there is no readable picture."""
    try:
        raw = np.frombuffer(path.read_bytes(), np.uint8)
    except OSError:
        return None
    image = cv2.imdecode(raw, cv2.IMREAD_COLOR) if len(raw) else None
    if image is None:
        return None
    height, width = image.shape[:2]
    factor = MAX_SIDE / max(height, width)
    if factor < 1.0:
        width, height = max(1, round(width * factor)), max(1, round(height * factor))
        image = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)
    _, jpeg = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    return "data:image/jpeg;base64," + base64.b64encode(jpeg.tobytes()).decode("ascii"), width, height

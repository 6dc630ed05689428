"""What is believed about the lenses of a set of photos, and what is held because the photos leave it open."""

import dataclasses
from dataclasses import dataclass

from graphgs.scene.camera import Camera
from graphgs.structure.calibration.consequence import ShapeChange
from graphgs.structure.calibration.lens import TITLES

_ADVICE = {
    "focal": ". If you know the focal length, give it with --set sources.focal_px=PIXELS",
    "k1": ". Photos from other heights, or tilted ones, would show it",
}


@dataclass(frozen=True)
class Step:
    """One or two parameters that were opened, and what the witnesses said."""

    parameters: tuple[str, ...]  # opened together
    beside: tuple[str, ...]  # believed before
    believed: bool
    deviation: float  # of the focal length, relative; of the others likewise, at the image's corner
    gain: float  # by which share the error of held-out tracks falls
    gain_deviation: float  # standard deviation of that
    reason: str  # "believed", or why not


@dataclass(frozen=True)
class Held:
    """A parameter that the photos leave open."""

    parameter: str
    values: tuple[float, ...]  # [px] of the cameras, for a focal length; else empty
    origin: str  # where they are from: "given", "EXIF" or "typical"
    uncertainty: float  # relative, one standard deviation
    shape: ShapeChange  # what it means for the scene

    def describe(self, unit: str = "", scale: float = 1.0) -> str:
        """A sentence for people; `unit` is that of the world, which is larger by `scale` than when this was found."""
        values = ", ".join(dict.fromkeys(f"{value:.0f} px" for value in self.values))
        value = f" at {values} ({self.origin})" if values else ""
        said = f"the photos do not determine their {TITLES[self.parameter]}: it is held{value} and may be off by "
        said += f"{100 * self.uncertainty:.0f} %" if self.uncertainty >= 0.01 else f"{100 * self.uncertainty:.1f} %"
        meant = self.shape.describe(unit, scale)
        return f"{said}; {meant}" if meant else said


@dataclass(frozen=True)
class Calibration:
    """Cameras with the parameters that bundle adjustment may refine; all others keep their values."""

    cameras: tuple[Camera, ...]  # of the model that was looked at
    refine: tuple[str, ...]  # parameters that the photos determine
    steps: tuple[Step, ...] = ()
    held: tuple[Held, ...] = ()

    def cautions(self, unit: str = "", scale: float = 1.0) -> tuple[str, ...]:
        """What the photos leave open and what that means, where it shows."""
        telling = [held for held in self.held if held.shape.matters]
        return tuple(held.describe(unit, scale) + _ADVICE.get(held.parameter, "") for held in telling)

    def describe(self) -> str:
        """One line: the focal lengths, what the photos determine, what is held."""
        focals = ", ".join(dict.fromkeys(f"{camera.focal_and_center[0]:.0f} px" for camera in self.cameras))
        found = ", ".join(TITLES[parameter] for parameter in self.refine)
        open_ones = "; ".join(held.describe() for held in self.held)
        said = f"focal length {focals}; the photos determine {found or 'nothing of their lenses'}"
        return f"{said}; {open_ones}" if open_ones else said

    def record(self) -> dict:
        """Plain values, for files and events."""
        return dataclasses.asdict(self)

    @staticmethod
    def from_record(values: dict) -> "Calibration":
        """What `record` made, from a file."""
        held = [{**h, "values": tuple(h["values"]), "shape": ShapeChange(**h["shape"])} for h in values["held"]]
        steps = [{**s, "parameters": tuple(s["parameters"]), "beside": tuple(s["beside"])} for s in values["steps"]]
        return Calibration(
            tuple(Camera(c["model"], c["width"], c["height"], tuple(c["params"])) for c in values["cameras"]),
            tuple(values["refine"]),
            tuple(Step(**step) for step in steps),
            tuple(Held(**entry) for entry in held),
        )

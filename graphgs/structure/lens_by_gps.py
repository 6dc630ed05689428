"""Where GPS contradicts the shape of a reconstruction, the question of its lenses is asked again."""

import dataclasses

from graphgs.structure.calibrated import with_parameters
from graphgs.structure.calibration.lens import PARAMETERS
from graphgs.structure.gps_shape import GpsShape, gps_shape
from graphgs.structure.ladder import Candidate, judged

_SETS = (("focal",), ("focal", "k1"), ("focal", "k1", "k2"), PARAMETERS)


def reopened(best: Candidate) -> tuple[Candidate, GpsShape | None]:
    """The candidate, or another with other parameters of its lenses free, if that takes the bend or stretch away
    and is accepted as well; and what GPS says of it."""
    calls = best.calls
    shape = gps_shape(best.reconstruction, calls.photos)
    if shape is None or calls.calibration is None or not (shape.bends or shape.stretches):
        return best, shape
    calls.reporter.event("gps_shape", refine=calls.prior.refine, **dataclasses.asdict(shape))
    found = best
    for parameters in _SETS:
        if parameters == calls.prior.refine:
            continue
        name = f"{best.name}_{'_'.join(parameters)}"
        other_calls, model = with_parameters(calls, best.reconstruction, name, parameters)
        if model is None:
            continue
        other = gps_shape(model, calls.photos)
        calls.reporter.event("gps_shape", refine=parameters, **dataclasses.asdict(other))
        if abs(other.bend_m) + abs(other.bend_deviation_m) < abs(shape.bend_m) and not other.stretches:
            candidate = judged(other_calls, model, name, f"{best.method}, lens by GPS", best.other, best.compared_with)
            if candidate.rank >= found.rank:
                found, shape = candidate, other
    return found, shape

"""Every setting of a run: one dataclass per stage, presets, TOML in and out, `stage.field=value`."""

import dataclasses
import json
import math
import tomllib
import types
import typing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from graphgs.errors import UsageError
from graphgs.points import PointsConfig
from graphgs.sources.config import SourcesConfig
from graphgs.structure.config import StructureConfig
from graphgs.structure.pairing_config import PairingConfig
from graphgs.training.config import TrainConfig

Preset = Literal["preview", "standard", "best"]


@dataclass(frozen=True)
class RunConfig:
    """What concerns the run as a whole."""

    device: str = "auto"
    """Where training runs: auto (CUDA if there is a card), cpu, cuda:0."""
    seed: int = 0
    """Of everything that draws."""
    prior: str = "auto"
    """Coarse poses that choose the pairs: auto (from the photos), learned (the same by XFeat), sequence (file order),
    gps (EXIF), gps=FILE (CSV or GeoJSON), poses=FILE. GPS also makes the result metric, with z up and y north."""
    allow_partial: bool = False
    """Go on, with exit code 0, also when the result is PARTIAL: only part of the photos could be placed."""


@dataclass(frozen=True)
class Config:
    """All settings in force; written to run.toml."""

    run: RunConfig = field(default_factory=RunConfig)
    sources: SourcesConfig = field(default_factory=SourcesConfig)
    structure: StructureConfig = field(default_factory=StructureConfig)
    pairing: PairingConfig = field(default_factory=PairingConfig)
    points: PointsConfig = field(default_factory=PointsConfig)
    training: TrainConfig = field(default_factory=TrainConfig)

    def replace(self, stage: str, **values) -> "Config":
        return dataclasses.replace(self, **{stage: dataclasses.replace(getattr(self, stage), **values)})


# preview: minutes on a laptop's CPU; standard: an evening on a CPU, minutes on a card; best: 3DGS's own length.
PRESETS: dict[Preset, dict[str, dict[str, Any]]] = {
    "preview": {"structure": {"max_side": 640}, "training": {"steps": 2_000, "max_splats": 20_000}},
    "standard": {"structure": {"max_side": 1200}, "training": {"steps": 10_000, "max_splats": 1_000_000}},
    "best": {
        "structure": {"max_side": 1600, "fine_features": 8192},
        "training": {"steps": 30_000, "max_splats": 3_000_000},
    },
}

# What numbers may be: at least 0, shares at most 1, and otherwise as said here.
_AT_LEAST = {
    "structure.fine_first_octave": -1, "structure.rig_baseline_m": 1e-4, "points.dense_partners": 2,
    "sources.given_scale": 1e-4,
} | dict.fromkeys(
    (
        "training.steps", "training.max_splats", "training.sh_degree_interval", "training.densify_interval",
        "training.opacity_reset_interval", "training.consistency_interval", "pairing.r", "pairing.w",
        "structure.retrieval_words", "structure.coarse_features", "structure.coarse_retry_features",
        "structure.fine_features", "structure.chunk_pairs", "points.target",
        "sources.focal_px",
    ), 1,
) | dict.fromkeys(
    (
        "sources.decode_max_side", "points.dense_max_side", "structure.coarse_max_side",
        "structure.coarse_retry_max_side",
        "structure.fine_max_side", "structure.max_side",
    ), 32,
)  # fmt: skip
_AT_MOST = {
    "training.sh_degree": 3,
    "training.ssim_weight": 1,
    "training.initial_opacity": 1,
    "structure.min_registered": 1,
    "structure.max_apart_share": 1,
    "structure.fine_first_octave": 4,
}


def preset(name: Preset, base: Config | None = None) -> Config:
    """`base` (default: every default) with the values of a preset."""
    config = Config() if base is None else base
    for stage, values in PRESETS[name].items():
        config = config.replace(stage, **values)
    return config


def with_settings(config: Config, settings: typing.Iterable[str]) -> Config:
    """Apply `stage.field=value` items. Raises UsageError for an unknown name or a value of another type."""
    for item in settings:
        path, equals, text = item.partition("=")
        stage, dot, name = path.strip().partition(".")
        if not (equals and dot):
            raise UsageError(f"--set {item}: expected stage.field=value", hint="for example --set training.steps=5000")
        config = _with_value(config, stage, name, text.strip(), where=f"--set {item}")
    return config


def with_file(config: Config, path: Path) -> Config:
    """Apply a TOML file with one table per stage, e.g. a run.toml of an earlier run."""
    try:
        tables = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise UsageError(f"{path}: cannot read the settings ({error.strerror})", hint="check the path") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise UsageError(f"{path}: not a TOML file: {error}", hint="a run.toml is a good example") from error
    for stage, values in tables.items():
        if stage == "made_by":  # run.toml says there what made it
            continue
        if not isinstance(values, dict):
            raise UsageError(f"{path}: {stage} is not a table", hint="settings stand below [stage] headings")
        for name, value in values.items():
            config = _with_value(config, stage, name, value, where=f"{path}, [{stage}] {name}")
    return config


def check_numbers(config: Config) -> None:
    """Raises UsageError for a number that no stage could work with."""
    for stage, values in dataclasses.asdict(config).items():
        for field_name, value in values.items():
            if isinstance(value, bool) or not isinstance(value, (int, float)):
                continue
            name = f"{stage}.{field_name}"
            least, most = _AT_LEAST.get(name, 0), _AT_MOST.get(name, 1 if name.endswith("_fraction") else math.inf)
            if not least <= value <= most:
                bounds = f"at least {least}" if most == math.inf else f"{least} to {most}"
                raise UsageError(f"{name} = {value}: expected {bounds}", hint="correct the value")


def to_toml(config: Config, made_by: dict[str, str]) -> str:
    """Every setting, with its stage as a table; None, which TOML does not have, is the word "none"."""
    tables = {"made_by": made_by} | dataclasses.asdict(config)
    lines = []
    for stage, values in tables.items():
        lines.append(f"[{stage}]")
        lines += [f"{name} = {_toml_value(value)}" for name, value in values.items()]
        lines.append("")
    return "\n".join(lines)


def _with_value(config: Config, stage: str, name: str, value: Any, *, where: str) -> Config:
    stages = [f.name for f in dataclasses.fields(config)]
    if stage not in stages:
        raise UsageError(f"{where}: there is no stage '{stage}'", hint=f"the stages are {', '.join(stages)}")
    kinds = typing.get_type_hints(type(getattr(config, stage)))
    if name not in kinds:
        raise UsageError(f"{where}: {stage} has no setting '{name}'", hint=f"it has {', '.join(kinds)}")
    try:
        return config.replace(stage, **{name: parse_value(value, kinds[name], where=where)})
    except ValueError as error:  # the stage's own check
        raise UsageError(f"{where}: {error}", hint="correct the value") from error


def parse_value(value: Any, kind: Any, *, where: str) -> Any:
    """`value` (text, or a TOML value) as `kind`. Raises UsageError if it is not one."""
    origin, choices = typing.get_origin(kind), typing.get_args(kind)
    if origin in (typing.Union, types.UnionType):
        if value in (None, "none", "None"):
            return None
        return parse_value(value, next(k for k in choices if k is not type(None)), where=where)
    if origin is Literal:
        if value in choices:
            return value
        raise UsageError(f"{where}: '{value}' is not possible", hint=f"choose one of {', '.join(map(str, choices))}")
    if kind is bool:
        words = {"true": True, "false": False}
        if isinstance(value, bool) or str(value).lower() in words:
            return value if isinstance(value, bool) else words[value.lower()]
    elif not isinstance(value, bool):
        try:
            parsed = kind(value)
            if kind is str or (math.isfinite(parsed) and (isinstance(value, str) or parsed == value)):
                return parsed
        except (TypeError, ValueError, OverflowError):
            pass  # said below, as for any other value that does not fit
    raise UsageError(f"{where}: expected {getattr(kind, '__name__', kind)}, got '{value}'", hint="correct the value")


def _toml_value(value: Any) -> str:
    if value is None:
        return '"none"'
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, (int, float)):
        return repr(value)
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(_toml_value(v) for v in value) + "]"
    return json.dumps(str(value))

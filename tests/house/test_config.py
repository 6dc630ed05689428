"""Settings: from presets, text and TOML, and back; and who reads them."""

import dataclasses
import fnmatch

import pytest

from graphgs import api, pipeline
from graphgs.config import PRESETS, Config, check_numbers, preset, to_toml, with_file, with_settings
from graphgs.errors import UsageError
from graphgs.options import SETTING_OF_OPTION, Options


def value_of(config: Config, name: str):
    return pipeline.flat_settings(config)[name]


@pytest.mark.parametrize("name", PRESETS)
def test_presets_change_what_they_say_and_nothing_else(name):
    expected = pipeline.flat_settings(Config()) | {
        f"{stage}.{field}": value for stage, values in PRESETS[name].items() for field, value in values.items()
    }
    assert pipeline.flat_settings(preset(name)) == expected
    check_numbers(preset(name))


@pytest.mark.parametrize(
    ("item", "value"),
    [
        ("training.steps=5000", 5000),
        ("training.steps = 1e3", None),
        ("training.ssim_weight=0.25", 0.25),
        ("training.ssim_weight=1", 1.0),
        ("run.allow_partial=true", True),
        ("run.allow_partial=False", False),
        ("run.allow_partial=1", None),
        ("run.prior=poses=my file.txt", "poses=my file.txt"),
        ("structure.max_side=800", 800),
        ("structure.max_side=none", "None"),
        ("structure.max_side=big", None),
        ("training.sampling=paper", "paper"),
        ("training.sampling=other", None),
        ("training.lambda_consistency=inf", None),
        ("training.image_cache_bytes=99999999999999999999", 99999999999999999999),
    ],
)
def test_a_setting_from_text(item, value):
    """None: refused; "None": the value None."""
    if value is None:
        with pytest.raises(UsageError, match=r"--set"):
            with_settings(Config(), [item])
        return
    name = item.partition("=")[0].strip()
    found = value_of(with_settings(preset("best"), [item]), name)
    assert found is None if value == "None" else (found == value and type(found) is type(value))


def test_later_settings_win():
    assert with_settings(Config(), ["training.steps=1", "training.steps=2"]).training.steps == 2


@pytest.mark.parametrize("item", ["nothing", "training=3", "nowhere.steps=3", "training.nothing=3", "=", "."])
def test_unknown_names_are_refused(item):
    with pytest.raises(UsageError) as refused:
        with_settings(Config(), [item])
    assert refused.value.hint


@pytest.mark.parametrize("base", PRESETS)
def test_toml_gives_the_same_settings_over_any_other(tmp_path, base):
    changes = ["structure.max_side=none", 'run.prior=poses=a "quoted" \\ path', "training.means_rate=1.25e-7"]
    config = with_settings(preset("preview"), [*changes, "run.allow_partial=true", "points.tau=0.5"])
    path = tmp_path / "run.toml"
    path.write_text(to_toml(config, {"input": 'C:\\photos\n"x"', "torch": "2.13"}))
    assert with_file(preset(base), path) == config


def test_options_go_over_the_file_and_set_over_options(tmp_path):
    path = tmp_path / "my.toml"
    path.write_text("[training]\nsteps = 11\nmax_splats = 22\nsh_degree = 1\n")
    options = Options(preset="preview", config=path, steps=33, max_splats=44, allow_partial=True)
    config = api.settings(options, ["training.max_splats=55"])
    assert (config.training.sh_degree, config.training.steps, config.training.max_splats) == (1, 33, 55)
    assert config.structure.max_side == PRESETS["preview"]["structure"]["max_side"]
    assert config.run.allow_partial


def test_a_base_is_kept_unless_a_preset_is_asked_for():
    base = with_settings(Config(), ["training.steps=7", "structure.max_side=none"])
    assert api.settings(Options(), base=base) == base
    assert api.settings(Options(preset="best"), base=base).training.steps == PRESETS["best"]["training"]["steps"]


def test_every_option_stands_for_a_setting():
    flat = pipeline.flat_settings(Config())
    assert set(SETTING_OF_OPTION.values()) <= flat.keys()
    own = {"preset", "threads", "allow_partial", "config"}
    assert {field.name for field in dataclasses.fields(Options)} == SETTING_OF_OPTION.keys() | own


def test_every_setting_is_in_a_key_or_declared_without_influence():
    """A setting that no stage's key holds could be changed without anything running again."""
    patterns = [pattern for patterns in pipeline.READS.values() for pattern in patterns]
    flat = pipeline.flat_settings(Config())
    for name in flat:
        assert name in pipeline.WITHOUT_INFLUENCE or any(fnmatch.fnmatchcase(name, p) for p in patterns), name
    for pattern in [*patterns, *pipeline.WITHOUT_INFLUENCE]:
        assert fnmatch.filter(flat, pattern), f"{pattern} names no setting"
    assert set(pipeline.READS) == {*pipeline.STAGES, pipeline.GIVEN}


def test_stages_have_their_own_places():
    assert [stage.order for stage in pipeline.STAGES] == list(range(1, len(pipeline.STAGES) + 1))
    assert len({stage.name for stage in pipeline.STAGES}) == len(pipeline.STAGES)

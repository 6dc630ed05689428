"""splat.ply: the layout as plyfile sees it, and what a bad file meets."""

import dataclasses

import numpy as np
import plyfile
import pytest
import torch

from graphgs.errors import DataError
from graphgs.export.ply import PROPERTIES, read_ply, write_ply
from graphgs.rendering.splats import NEAR, TENSORS, Splats


@pytest.fixture
def splats() -> Splats:
    generator = torch.Generator().manual_seed(3)

    def draw(*shape):
        return torch.randn(shape, generator=generator)

    return Splats(draw(6, 3), draw(6, 4), draw(6, 3), draw(6), draw(6, 16, 3))


def test_layout_is_the_field_s(splats, tmp_path):
    write_ply(splats, tmp_path / "splat.ply")
    ply = plyfile.PlyData.read(tmp_path / "splat.ply")
    assert not ply.text
    assert ply.byte_order == "<"
    vertex = ply["vertex"]
    names = [p.name for p in vertex.properties]
    expected = ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"]
    expected += [f"f_rest_{k}" for k in range(45)]
    expected += ["opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]
    assert names == expected
    assert len(names) == 62
    assert {str(p.val_dtype) for p in vertex.properties} == {"f4"}
    np.testing.assert_array_equal(vertex["y"], splats.means[:, 1])
    np.testing.assert_array_equal(vertex["nx"], 0.0)
    np.testing.assert_array_equal(vertex["f_dc_2"], splats.sh_coeffs[:, 0, 2])
    for channel in range(3):
        for k in range(15):
            np.testing.assert_array_equal(vertex[f"f_rest_{15 * channel + k}"], splats.sh_coeffs[:, 1 + k, channel])
    np.testing.assert_allclose(1 / (1 + np.exp(-vertex["opacity"])), splats.opacities, rtol=1e-6)
    np.testing.assert_allclose(np.exp(vertex["scale_1"]), splats.scales[:, 1], rtol=1e-6)
    np.testing.assert_array_equal(np.stack([vertex[f"rot_{k}"] for k in range(4)], 1), splats.quats)


def test_reading_gives_the_same_bits_back(splats, tmp_path):
    write_ply(splats, tmp_path / "splat.ply")
    loaded = read_ply(tmp_path / "splat.ply")
    assert all(torch.equal(getattr(loaded, name), getattr(splats, name)) for name in TENSORS)
    assert not list(tmp_path.glob("*.partial"))


def test_the_near_plane_comes_back(splats, tmp_path):
    write_ply(dataclasses.replace(splats, near=0.1234567), tmp_path / "splat.ply")
    assert read_ply(tmp_path / "splat.ply").near == 0.1234567


@pytest.mark.parametrize("comment", ["near", "near 0", "near nan", "near -1", "near by", "near 1 2"])
def test_a_comment_that_is_no_near_plane_is_a_comment(splats, tmp_path, comment):
    write_ply(dataclasses.replace(splats, near=0.5), tmp_path / "splat.ply")
    data = (tmp_path / "splat.ply").read_bytes().replace(b"near 0.5", comment.encode())
    (tmp_path / "splat.ply").write_bytes(data)
    assert read_ply(tmp_path / "splat.ply").near == NEAR


def test_harmonics_above_the_degree_are_zero_in_the_file(splats, tmp_path):
    low = Splats(**{name: getattr(splats, name) for name in TENSORS}, sh_degree=1)
    write_ply(low, tmp_path / "splat.ply")
    loaded = read_ply(tmp_path / "splat.ply")
    assert torch.equal(loaded.sh_coeffs[:, :4], splats.sh_coeffs[:, :4])
    assert not loaded.sh_coeffs[:, 4:].any()


def test_degree_of_another_trainer_s_file_is_recognised(splats, tmp_path):
    keep = [name for name in PROPERTIES if not name.startswith(("f_rest_", "n"))] + [f"f_rest_{k}" for k in range(9)]
    rows = np.zeros(2, dtype=[(name, "<f4") for name in keep])
    rows["f_rest_4"] = 0.25  # green, second harmonic of three
    plyfile.PlyData([plyfile.PlyElement.describe(rows, "vertex")], byte_order="<").write(tmp_path / "a.ply")
    loaded = read_ply(tmp_path / "a.ply")
    assert loaded.sh_degree == 1
    assert loaded.sh_coeffs[0, 2, 1] == 0.25
    assert int((loaded.sh_coeffs != 0).sum()) == 2


def test_values_that_are_not_finite_are_not_written(splats, tmp_path):
    splats.means[2, 1] = float("nan")
    with pytest.raises(DataError, match="not finite"):
        write_ply(splats, tmp_path / "splat.ply")
    assert not list(tmp_path.iterdir())


def _damaged(name: str, whole: bytes) -> bytes:
    return {
        "cut": whole[:-5],
        "longer": whole + b"x",
        "huge count": whole.replace(b"vertex 6", b"vertex 999999999999"),
        "no header": b"hello",
        "ascii": whole.replace(b"binary_little_endian", b"ascii"),
        "list": whole.replace(b"property float nx", b"property list uchar int nx"),
        "second element": whole.replace(b"end_header", b"element face 3\nend_header"),
        "renamed": whole.replace(b"float opacity", b"float opacitx"),
        "nan": whole[:-4] + np.float32(np.nan).tobytes(),
        "empty": b"",
    }[name]


@pytest.mark.parametrize(
    "name", ["cut", "longer", "huge count", "no header", "ascii", "list", "second element", "renamed", "nan", "empty"]
)
def test_a_bad_file_is_refused(splats, tmp_path, name):
    write_ply(splats, tmp_path / "splat.ply")
    bad = tmp_path / "bad.ply"
    bad.write_bytes(_damaged(name, (tmp_path / "splat.ply").read_bytes()))
    with pytest.raises(DataError, match=r"bad\.ply"):
        read_ply(bad)


def test_a_missing_file_is_refused(tmp_path):
    with pytest.raises(DataError, match="No such file"):
        read_ply(tmp_path / "absent.ply")

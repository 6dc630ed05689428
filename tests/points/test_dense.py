"""The dense cloud: on the surfaces, from training photos alone, the same for any number of threads."""

import dataclasses

import cv2
import numpy as np
import pytest

from graphgs.points import DenseCloud, PointsConfig, dense, dense_cloud
from graphgs.points.partners import sweep_partners
from graphgs.points.swept_view import SmallView
from graphgs.progress import Reporter
from tests.support.textured_walls import HEIGHT, WIDTH, off_the_walls, textured_walls


def _cloud(walls, *, threads: int = 1, **settings) -> DenseCloud:
    return dense_cloud(PointsConfig(**settings), walls.model, walls.views, reporter=Reporter(), threads=threads)


def test_points_lie_on_the_surfaces(tmp_path):
    walls = textured_walls(tmp_path)
    cloud = _cloud(walls)
    assert len(cloud) > 6 * 0.5 * WIDTH * HEIGHT  # of six training photos
    distance = off_the_walls(cloud.positions)
    assert np.median(distance) < 0.02  # at a distance of 4
    assert (distance < 0.1).mean() > 0.98
    assert cloud.colors.shape == (len(cloud), 3)
    assert (cloud.track_lengths >= 3).all()


def test_colours_are_the_photos(tmp_path):
    walls = textured_walls(tmp_path)
    cloud = _cloud(walls)
    camera, K = walls.views.viewmats[3], walls.views.Ks[3]
    pixels = (cloud.positions @ camera[:3, :3].T + camera[:3, 3]) @ K.T
    columns, rows = np.floor(pixels[:, :2] / pixels[:, 2:]).astype(int).T
    inside = (columns >= 0) & (columns < WIDTH) & (rows >= 0) & (rows < HEIGHT)
    photo = walls.views.read(3)[0][rows[inside], columns[inside]].astype(float)
    assert np.median(np.abs(photo - cloud.colors[inside])) < 12  # the texture changes by more from pixel to pixel


def test_smaller_photos_give_fewer_points(tmp_path):
    walls = textured_walls(tmp_path)
    whole, half = _cloud(walls), _cloud(walls, dense_max_side=48)
    assert len(half) < 0.4 * len(whole)
    assert (set(whole.pixels), set(half.pixels)) == ({1.0}, {2.0})
    assert np.median(off_the_walls(half.positions)) < 0.04


def test_held_out_photos_are_not_read(tmp_path):
    walls = textured_walls(tmp_path, is_test=(0, 3))
    expected = _cloud(walls)
    for name in ("0.png", "3.png"):
        cv2.imwrite(str(tmp_path / name), np.zeros((HEIGHT, WIDTH, 3), np.uint8))
    changed = _cloud(walls)
    assert np.array_equal(expected.positions, changed.positions)
    (tmp_path / "0.png").unlink()
    (tmp_path / "3.png").unlink()
    assert np.array_equal(expected.positions, _cloud(walls).positions)


def test_masked_pixels_have_no_points(tmp_path):
    walls = textured_walls(tmp_path)
    mask = np.full((HEIGHT, WIDTH), 255, np.uint8)
    mask[:, : WIDTH // 2] = 0
    cv2.imwrite(str(tmp_path / "mask.png"), mask)
    masked = dataclasses.replace(walls, views=dataclasses.replace(walls.views, masks=("mask.png",) * 7))
    whole, half = _cloud(walls), _cloud(masked)
    assert 0 < len(half) < 0.6 * len(whole)


def test_the_edge_of_a_mask_has_no_points(tmp_path):
    """A dark bonnet in all photos: its edge looks alike everywhere, and lies on no surface."""
    walls = textured_walls(tmp_path)
    mask = np.full((HEIGHT, WIDTH), 255, np.uint8)
    mask[-20:] = 0
    for name in walls.views.images:
        photo = cv2.imread(str(tmp_path / name))
        photo[-20:] = 20
        cv2.imwrite(str(tmp_path / name), photo)
    cv2.imwrite(str(tmp_path / "mask.png"), mask)
    masked = dataclasses.replace(walls, views=dataclasses.replace(walls.views, masks=("mask.png",) * 7))
    cloud = _cloud(masked)
    assert len(cloud) > 1000
    assert (off_the_walls(cloud.positions) < 0.1).mean() > 0.98


def test_photos_of_other_sizes_are_reduced_by_their_own_factor(tmp_path):
    walls = textured_walls(tmp_path)
    large = cv2.resize(cv2.imread(str(tmp_path / "3.png")), (2 * WIDTH, 2 * HEIGHT), interpolation=cv2.INTER_CUBIC)
    cv2.imwrite(str(tmp_path / "3.png"), large)
    sizes, Ks = walls.views.sizes.copy(), walls.views.Ks.copy()
    sizes[3] *= 2
    Ks[3, :2] *= 2
    mixed = dataclasses.replace(walls, views=dataclasses.replace(walls.views, sizes=sizes, Ks=Ks))
    cloud = _cloud(mixed, dense_max_side=WIDTH)
    assert [set(cloud.pixels[cloud.views == i]) for i in (2, 3)] == [{1.0}, {2.0}]
    assert np.median(off_the_walls(cloud.positions)) < 0.02


def test_any_number_of_threads_gives_the_same(tmp_path):
    walls = textured_walls(tmp_path)
    one, three = _cloud(walls), _cloud(walls, threads=3)
    assert np.array_equal(one.positions, three.positions)
    assert np.array_equal(one.colors, three.colors)


def test_each_photo_gives_at_most_its_share(tmp_path, monkeypatch):
    walls = textured_walls(tmp_path)
    monkeypatch.setattr(dense, "MOST_POINTS", 600)
    assert len(_cloud(walls)) == 600


def test_very_many_photos_are_made_smaller(tmp_path, monkeypatch):
    walls = textured_walls(tmp_path)
    monkeypatch.setattr(dense, "MOST_PIXELS", 6 * WIDTH * HEIGHT / 4)
    assert set(_cloud(walls).pixels) == {2.0}


def test_an_interrupted_search_goes_on(tmp_path, monkeypatch):
    walls, swept, searched = textured_walls(tmp_path), SmallView.swept, []
    expected = _cloud(walls)

    def interrupted(view, *rest):
        searched.append(view)
        if len(searched) == 4:
            raise KeyboardInterrupt
        return swept(view, *rest)

    def search() -> DenseCloud:
        return dense_cloud(
            PointsConfig(), walls.model, walls.views, reporter=Reporter(), threads=1, scratch=tmp_path / "scratch"
        )

    (tmp_path / "scratch").mkdir()
    monkeypatch.setattr(SmallView, "swept", interrupted)
    with pytest.raises(KeyboardInterrupt):
        search()
    kept = len(list((tmp_path / "scratch").glob("*.npy")))
    del searched[4:]
    found = search()
    assert 3 <= kept < 6
    assert len(searched) - 4 == 6 - kept
    assert np.array_equal(found.positions, expected.positions)


def test_saved_and_loaded(tmp_path):
    cloud = _cloud(textured_walls(tmp_path), dense_max_side=48)
    cloud.save(tmp_path / "kept")
    again = DenseCloud.load(tmp_path / "kept")
    for field in dataclasses.fields(cloud):
        assert np.array_equal(getattr(cloud, field.name), getattr(again, field.name))


def test_nothing_to_agree_with_gives_an_empty_cloud(tmp_path):
    walls = textured_walls(tmp_path)
    few = dataclasses.replace(walls.views, is_test=np.array([True] * 5 + [False] * 2))
    assert len(_cloud(dataclasses.replace(walls, views=few))) == 0
    assert len(_cloud(walls, dense="none")) == 0


def test_photos_from_one_place_are_no_partners(tmp_path):
    """They look alike on every plane. Here three are from one place, and were the three that share most."""
    walls = textured_walls(tmp_path, cameras=5, is_test=(), along=(-0.01, 0.0, 0.01, -0.6, 0.6))
    partners = sweep_partners(walls.model, np.ones(5, bool), 4)
    assert [set(chosen) for chosen in partners[:3]] == [{3, 4}] * 3
    assert np.median(off_the_walls(_cloud(walls).positions)) < 0.02


def test_partners_share_points_and_are_training_photos(tmp_path):
    model = textured_walls(tmp_path).model
    usable = np.arange(7) != 2
    partners = sweep_partners(model, usable, 4)
    assert len(partners[2]) == 0
    assert all(2 not in chosen and i not in chosen for i, chosen in enumerate(partners))
    assert set(partners[3][:2]) <= {1, 4, 5}
    assert len(partners[3]) == 4


def test_partners_at_a_good_angle_come_first(tmp_path):
    walls = textured_walls(tmp_path, cameras=13)  # 2 to 3 degrees from one to the next: too little
    first = sweep_partners(walls.model, np.ones(13, bool), 4)[6]
    assert set(first[:2]) <= {3, 4, 8, 9}


@pytest.mark.parametrize("count", [0, 5])
def test_photos_without_points_have_no_partners(tmp_path, count):
    model = textured_walls(tmp_path).model
    cut = model.track_offsets[count]
    few = dataclasses.replace(
        model, points=model.points[:count], colors=model.colors[:count], errors=model.errors[:count],
        track_offsets=model.track_offsets[: count + 1], track_images=model.track_images[:cut],
        track_xy=model.track_xy[:cut],
    )  # fmt: skip
    assert all(len(chosen) == 0 for chosen in sweep_partners(few, np.ones(7, bool), 4))


def test_each_point_is_known_by_its_view(tmp_path):
    walls = textured_walls(tmp_path)
    cloud = _cloud(walls)
    assert set(cloud.views) == {1, 2, 3, 4, 5, 6}
    for i in (1, 6):
        found = cloud.positions[cloud.views == i]
        in_camera = found @ walls.views.viewmats[i, :3, :3].T + walls.views.viewmats[i, :3, 3]
        pixels = in_camera @ walls.views.Ks[i].T
        pixels = pixels[:, :2] / pixels[:, 2:]
        assert np.allclose(pixels % 1.0, 0.5, atol=1e-6)  # at the middles of pixels
        columns, rows = pixels.astype(int).T
        assert np.median(np.abs(in_camera[:, 2] / walls.depths[i][rows, columns] - 1)) < 0.01


def test_the_part_of_some_views(tmp_path):
    cloud = _cloud(textured_walls(tmp_path))
    part = cloud.of_views(np.array([2, 5]))
    assert np.array_equal(part.positions[part.views == 0], cloud.positions[cloud.views == 2])
    assert np.array_equal(part.positions[part.views == 1], cloud.positions[cloud.views == 5])
    assert len(part) == np.isin(cloud.views, [2, 5]).sum()

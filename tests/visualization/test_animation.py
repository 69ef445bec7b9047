# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Epochs one after the other."""

from types import SimpleNamespace

import astropy.units as u
import numpy as np
import pytest
from matplotlib.animation import writers
from PIL import Image

from astro_scc import EpochCube
from astro_scc.visualization import animate_epochs, write_animation

UNEVEN = ["2000-01-01", "2000-02-01", "2002-01-01"]


@pytest.fixture(scope="module")
def small():
    data = np.random.default_rng(1).standard_normal((3, 20, 30))
    return EpochCube.from_arrays(data, UNEVEN, pixel_scale=0.1 * u.mas)


@pytest.fixture
def animate():
    """Animations that are never shown say so when they go."""
    made = []

    def run(*args, **kwargs):
        made.append(animate_epochs(*args, **kwargs))
        return made[-1]

    yield run
    for animation in made:
        animation._draw_was_started = True


def draw(animation, index):
    """One frame, its image and the marks of each kind."""
    animation._func(index)
    ax = animation._fig.axes[0]
    trail = [c for c in ax.collections if c.get_gid() == "trail"]
    now = [x for line in ax.lines for x in line.get_xdata()]
    return SimpleNamespace(
        title=ax.get_title(),
        image=ax.images[0].get_array(),
        now=np.array(now),
        trail=trail[0] if trail else None,
        patches=len(ax.patches),
    )


def test_each_frame_is_its_epoch(animate, small):
    animation = animate(small)
    assert list(animation.new_frame_seq()) == [0, 1, 2]
    for k in (0, 2, 1):
        frame = draw(animation, k)
        assert frame.title == UNEVEN[k]
        assert np.array_equal(frame.image, small.data[k])


def test_equal_steps_of_time(animate, small):
    # Over two years the second epoch is a month after the first, and then shown on.
    assert list(animate(small, n_frames=5).new_frame_seq()) == [0, 1, 1, 1, 2]
    assert list(animate(small, n_frames=1).new_frame_seq()) == [0]


def test_ssps_move_and_leave_a_trail(animate, matched):
    from astro_scc.measurement.feature_tables import ssp_table

    cube = matched.cube
    table = ssp_table(matched.ssps, cube, select=matched.select)
    animation = animate(cube, table, trail=1, unit="mas")
    for k in (0, 3, 1):
        frame = draw(animation, k)
        here = table["epoch"] == k
        assert np.allclose(np.sort(frame.now), np.sort(table["east"][here].value))
        past = table["east"][table["epoch"] == k - 1].value
        trail = [] if frame.trail is None else frame.trail.get_offsets()[:, 0]
        assert np.allclose(np.sort(trail), np.sort(past))
        # One beam at a time: what a frame adds, the next takes away.
        assert frame.patches == (cube.beams is not None)


def test_outlines(animate, matched):
    frame = draw(animate(matched.cube, matched.ssps), 2)
    assert frame.title == matched.cube.labels[2][:10]


@pytest.mark.slow
def test_gif(tmp_path, animate, small):
    path = write_animation(animate(small, n_frames=2), tmp_path / "a.gif", dpi=20)
    with Image.open(path) as image:
        assert image.n_frames == 2
        assert image.info["duration"] == 400
    with pytest.raises(OSError, match=r"a\.gif: exists"):
        write_animation(animate(small), path)
    faster = animate(small, n_frames=2, interval=0.1 * u.s)
    write_animation(faster, path, dpi=20, overwrite=True)
    with Image.open(path) as image:
        assert image.info["duration"] == 100


@pytest.mark.skipif(not writers.is_available("ffmpeg"), reason="needs ffmpeg")
def test_mp4(tmp_path, animate, small):
    path = write_animation(animate(small), tmp_path / "a.mp4", dpi=40)
    assert path.read_bytes()[4:8] == b"ftyp"


def test_without_ffmpeg(tmp_path, animate, small, monkeypatch):
    monkeypatch.setattr(writers, "is_available", lambda name: False)
    with pytest.raises(OSError, match=r"a\.mp4: the program ffmpeg is not found"):
        write_animation(animate(small), tmp_path / "a.mp4")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"n_frames": 0}, "n_frames must be at least 1"),
        ({"trail": -1}, "trail must be at least 0"),
        ({"interval": 0 * u.s}, "interval must be positive"),
        ({"stretch": "cubic"}, "unknown stretch"),
        ({"unit": "s"}, "unit must be an angle"),
    ],
)
def test_what_is_refused(small, options, message):
    with pytest.raises(ValueError, match=message):
        animate_epochs(small, **options)


def test_unknown_ending(tmp_path, animate, small):
    with pytest.raises(ValueError, match=r"a\.avi: animations are written as"):
        write_animation(animate(small), tmp_path / "a.avi")


def test_plot_of_a_cube(small):
    assert small.plot(1).axes[0].get_title() == UNEVEN[1]
    assert len(small.plot().axes) >= 3

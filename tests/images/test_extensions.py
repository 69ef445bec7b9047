# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Which image of a file is read, which pixels are missing, and what is damaged."""

import bz2
import gzip
import lzma
import warnings

import astropy.units as u
import numpy as np
import pytest
from astropy.io import fits
from astropy.table import Table

from astro_scc.cli import main
from astro_scc.epochs import EpochCube, inspect_epochs
from astro_scc.images.fits import find_files, looks_like_mask, read_plane
from astro_scc.images.pixels import missing

SHAPE = (24, 36)
NOISE = np.random.default_rng(1).normal(size=(4, *SHAPE))
IMAGE, OTHER, SMALL = NOISE[0], NOISE[1], NOISE[2, :12, :18]
WEIGHT = np.abs(NOISE[3]) + 1


def header(unit="JY/BEAM", wcs=True, **cards):
    celestial = {"CTYPE1": "RA---SIN", "CTYPE2": "DEC--SIN", "CRVAL1": 83.0,
                 "CRVAL2": 22.0, "CRPIX1": 18.0, "CRPIX2": 12.0, "CDELT1": -1e-6,
                 "CDELT2": 1e-6}  # fmt: skip
    own = celestial if wcs else {}
    return fits.Header(own | ({"BUNIT": unit} if unit else {}) | cards)


def write(path, *images, **cards):
    """Write images, each (name, pixels, unit, whether it has coordinates, cards)."""
    hdus = []
    for k, (name, pixels, *more) in enumerate(images):
        unit, wcs, own = (*more, *("JY/BEAM", True, {})[len(more) :])
        head = header(unit, wcs, **own)
        if pixels is None:
            head = fits.Header({k: v for k, v in head.items() if k not in header()})
        made = (fits.ImageHDU if k else fits.PrimaryHDU)(pixels, head)
        if k:
            made.name = name
        hdus.append(made)
    hdus[0].header.update({"DATE-OBS": "2015-06-18", **cards})
    fits.HDUList(hdus).writeto(path, overwrite=True)
    return path


EMPTY = ("", None)
SCI = ("SCI", IMAGE)
ERR = ("ERR", np.full(SHAPE, 0.5), None, False)
#: Images of a file; that of IMAGE is meant.
FOUND = {
    "one": [("", IMAGE)],
    "weight first, no name": [("", WEIGHT, None), ("A", IMAGE)],
    "exposure first by its unit": [("", WEIGHT, "s"), ("A", IMAGE)],
    "PSF first": [EMPTY, ("PSF", OTHER), ("IMAGE", IMAGE)],
    "Herschel": [EMPTY, ("coverage", WEIGHT, None), ("image", IMAGE),
                 ("stDev", WEIGHT)],
    "without coordinates": [("", OTHER, "JY/BEAM", False), ("A", IMAGE)],
    "another shape": [EMPTY, ("A", np.ones((5, *SHAPE))), ("B", IMAGE)],
    "preview": [EMPTY, ("PREVIEW", SMALL, None, False), ("MAP", IMAGE)],
    "primary and others": [("", IMAGE), ("RESIDUAL", OTHER, None, False)],
    "CCDData": [("", IMAGE), ("MASK", np.zeros(SHAPE, "u1"), None, False),
                ("UNCERT", np.full(SHAPE, 2.0), None, False)],
    "HST": [EMPTY, SCI, ("ERR", WEIGHT), ("DQ", np.eye(24, 36, 99, int))],
}  # fmt: skip


@pytest.mark.parametrize("name", FOUND)
def test_the_science_image_is_found(tmp_path, name):
    path = write(tmp_path / "a.fits", *FOUND[name])
    plane = read_plane(path)
    assert np.array_equal(plane.data, IMAGE)
    assert (plane.unit, plane.time.isot[:10]) == (u.Jy / u.beam, "2015-06-18")
    assert not plane.mask.any()


TWO = [EMPTY, ("SCI", IMAGE), ("DQ", np.zeros(SHAPE, int)), ("SCI", OTHER),
       ("DQ", np.eye(*SHAPE, dtype=int))]  # fmt: skip


def test_images_of_which_several_may_be_meant(tmp_path):
    for images, words in [
        (TWO, r"has 2 images, \[SCI,1\], \[SCI,2\]; choose one .*'a.fits\[SCI,1\]'"),
        ([("", IMAGE), ("RESIDUAL", OTHER)], r"\[PRIMARY\], \[RESIDUAL\]; choose one"),
    ]:
        path = write(tmp_path / "a.fits", *images)
        with pytest.raises(ValueError, match=f"a.fits: .*{words}"):
            EpochCube.read(path)
        assert "choose one by its name" in inspect_epochs(path)["problem"][0]


@pytest.mark.parametrize(
    ("choice", "expected"), [("SCI,2", OTHER), ("sci, 1", IMAGE), ("3", OTHER)]
)
@pytest.mark.parametrize("versions", [True, False])
def test_an_image_is_chosen_behind_the_name(tmp_path, choice, expected, versions):
    paths = []
    for i in (1, 2):
        date = f"201{i}-06-18"
        paths.append(write(tmp_path / f"{i}.fits", *TWO, **{"DATE-OBS": date}))
        with fits.open(paths[-1], mode="update") as hdus:
            for k in range(1, 5 if versions else 0):
                hdus[k].header["EXTVER"] = 1 + (k > 2)
    plane = read_plane(f"{paths[0]}[{choice}]")
    assert np.array_equal(plane.data, expected)
    # The flags are those of the version.
    assert plane.mask.sum() == (24 if expected is OTHER else 0)
    names = f"{tmp_path}/*.fits[{choice}]"
    assert [path.name for path in find_files(names)][1] == f"2.fits[{choice}]"
    cube = EpochCube.read(names)
    assert np.array_equal(cube.data[1][~cube.mask[1]], expected[~cube.mask[1]])
    part = EpochCube.read(names, region=(slice(2, 9), slice(3, 30)))
    assert np.array_equal(part.mask, cube.mask[:, 2:9, 3:30])
    assert main(["inspect", names]) == 0
    for choice in ("SCI,3", "9"):
        with pytest.raises(ValueError, match=rf"1.fits: has no image \[{choice}\]"):
            EpochCube.read(f"{paths[0]}[{choice}]")


BAD = np.zeros(SHAPE, dtype=bool)
BAD[5, 7], BAD[:, 20] = True, True
WILD = np.where(BAD, 99.0, IMAGE)
LOST = np.where(BAD, np.nan, IMAGE)
PADDED = np.zeros((40, 60))
PADDED[8:32, 12:48] = IMAGE
INSIDE = np.ones(PADDED.shape, dtype=bool)
INSIDE[8:32, 12:48] = False
HALF = PADDED.copy()
HALF[:8] = np.nan
GAP = PADDED.copy()
GAP[18:22] = 0
#: Pixels, extensions beside them, cards, and the pixels that are missing.
MISSING = {
    "flags of no sign": (WILD, [("DQ", (4 * BAD).astype("u4"))], {}, BAD),
    "flags of JWST": (WILD, [("DQ", np.where(BAD, 5, 4))], {"TELESCOP": "JWST"}, BAD),
    "a mask": (WILD, [("MASK", BAD.astype("u1"))], {}, BAD),
    "a mask of good pixels": (LOST, [("MASK", (~BAD).astype("u1"))], {}, BAD),
    "weights": (WILD, [("WHT", np.where(BAD, 0.0, 7.0))], {}, BAD),
    "errors of 0": (WILD, [("ERR", np.where(BAD, 0.0, 0.5))], {}, BAD),
    "errors that are NaN": (WILD, [("ERR", np.where(BAD, np.nan, 0.5))], {}, BAD),
    "flags and errors": (WILD, [("ERR", np.full(SHAPE, 0.5)), ("DQ", 4 * BAD)], {},
                         BAD),
    "huge errors": (2 * IMAGE + 9 * BAD, [("ERR", np.where(BAD, 1e30, 0.5))], {}, BAD),
    "1e20": (np.where(BAD, 1e20, IMAGE), [], {}, BAD),
    "-32768 and 1e30": (np.where(INSIDE, -32768, np.where(PADDED > 2.5, 2.5, PADDED)),
                        [], {}, INSIDE),
    "zeros and 1e20": (np.where(HALF != HALF, 1e20, PADDED), [], {}, INSIDE),
    "zeros about a sky": (np.where(INSIDE, 0, PADDED + 20), [], {}, INSIDE),
    "zeros and NaN": (HALF, [], {}, INSIDE),
    "a gap": (GAP, [], {}, GAP == 0),
}  # fmt: skip


#: Numbers for missing pixels, of which a remark tells.
FILLED = {"1e20": "1e+20", "-32768 and 1e30": "-32768", "zeros and 1e20": "1e+20"}


@pytest.mark.parametrize("name", MISSING)
def test_pixels_that_are_missing(tmp_path, name):
    pixels, beside, cards, missing = MISSING[name]
    own = [(key, values, None, False) for key, values in beside]
    path = write(tmp_path / "a.fits", EMPTY, ("SCI", pixels), *own, **cards)
    plane = read_plane(path)
    plane.take_uncertainty()
    assert np.array_equal(plane.mask, missing)
    assert np.array_equal(plane.data, pixels, equal_nan=True)
    if "errors" in name:
        assert plane.noise == 0.5 * u.Jy / u.beam
    said, expected = "; ".join(plane.notes), ""
    if "good" in name:
        expected = "its extension MASK has 0 where there are no values: 1 is taken for"
    elif name in FILLED or name.startswith("errors"):
        number = FILLED.get(name, "99")
        expected = f"its pixels of exactly {number} are taken for missing ones; write"
    assert said.startswith(expected)
    assert bool(said) == bool(expected)


Y, X = np.indices((40, 60))
BLOB = np.exp(-((X - 20) ** 2 + (Y - 20) ** 2) / 8)
#: Images whose zeros are values.
VALUES = {
    "noise": np.where(NOISE[0] > 2, 0, NOISE[0]),
    "counts": np.random.default_rng(1).poisson(0.05, (40, 60)).astype(float),
    "no noise": np.where(BLOB < 1e-30, 0, BLOB),
    "above a threshold": np.where(BLOB < 0.1, 0, BLOB),
    "one component": np.where(BLOB == 1, 1.0, 0.0),
    "nothing": np.zeros((8, 8)),
    "a sky without noise": BLOB.clip(0.05) + 100,
    "two values": np.where(BLOB > 0.5, 7.0, 3.0),
}


def test_zeros_that_are_values():
    for name, image in VALUES.items():
        bad, remark = missing(image)
        assert (bad.any(), remark) == (False, ""), name


GOOD = (~BAD).astype("u1")
ERRORS = np.linspace(0.1, 1, IMAGE.size).reshape(SHAPE)


def test_extensions_that_cannot_be_right(tmp_path):
    for pixels, beside, words in [
        (WILD, ("MASK", GOOD), "its extension MASK marks 97% of the pixels, which are"),
        (IMAGE, ("DQ", np.ones(SHAPE, int)), "its extension DQ marks 100% of the pix"),
        (IMAGE, ("DQ", np.ones((3, 4), int)), r"extension DQ has shape \(3, 4\), it"),
        (IMAGE, ("ERR", np.ones((3, 4))), r"extension ERR has shape \(3, 4\), it \("),
        (IMAGE, ("WHT", np.zeros(SHAPE)), "no valid pixel by its extension WHT; leave"),
    ]:  # fmt: skip
        path = write(
            tmp_path / "a.fits", EMPTY, ("SCI", pixels), (*beside, None, False)
        )
        with pytest.raises(ValueError, match=f"a.fits: .*{words}"):
            EpochCube.read(path)


def test_errors_are_the_noise(tmp_path):
    for name, values, unit, noise in [
        ("ERR", np.full(SHAPE, 0.5), None, 0.5),
        ("ERR", np.full(SHAPE, 500.0), "mJy/beam", 0.5),
        ("ERR", np.full(SHAPE, 0.5), "furlong", 0.5),
        ("VAR", np.full(SHAPE, 0.25), None, 0.5),
        ("ERR", np.zeros(SHAPE), None, None),
        ("ERR", ERRORS, None, np.median(ERRORS)),
    ]:
        path = write(tmp_path / "a.fits", EMPTY, SCI, (name, values, unit, False))
        with warnings.catch_warnings(record=True, action="always") as said:
            cube = EpochCube.read(path)
        uneven = ["its uncertainty differs" in str(one.message) for one in said]
        assert uneven == [True] * (values is ERRORS)
        assert noise == (None if cube.noise is None else cube.noise[0].value)
        assert not cube.mask.any()


def test_brightness_that_does_not_add_up(tmp_path):
    for unit in ("mag", "mag(AB)", "dB", "log(Jy)"):
        path = write(tmp_path / "a.fits", ("", IMAGE, unit))
        with pytest.raises(ValueError, match="a.fits: its unit is .*, a logarithm of"):
            EpochCube.read(path)
    write(path, ("", IMAGE, ""), BSOFTEN=100.0, BOFFSET=3.0)
    with pytest.raises(ValueError, match="a.fits: its brightness is stretched by asin"):
        EpochCube.read(path)


@pytest.mark.parametrize("name", ["spots.csv", "spots.vot", "spots.dat"])
def test_lists_of_spots_are_told_how_to_become_tables(tmp_path, name, capsys):
    (tmp_path / name).write_text("x,y,flux\n1,2,3\n")
    assert main(["measure", str(tmp_path / name), "-o", str(tmp_path / "out")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    words = "is a table and no image; ", "lay the ReadMe of CDS beside it, or "
    assert f"{words['d' in name]}a list of spots or components" in line
    assert "table.write('spots.ecsv')" in line
    assert "no image" in inspect_epochs(tmp_path / name)["problem"][0]


PIXELS = np.random.default_rng(1).normal(size=(1, 1, 16, 32))


def test_stokes_i_is_taken_from_several_planes(make_fits):
    data = np.concatenate([PIXELS + k for k in range(4)])
    for plane, changes in ((0, {}), (3, {"CRVAL4": 4.0, "CDELT4": -1.0})):
        image = read_plane(make_fits(data=data, **changes))
        assert np.array_equal(image.data, data[plane, 0])


def refused(path, words, error=OSError):
    """The file is refused in one line that names it."""
    with pytest.raises(error, match=words) as caught:
        read_plane(path)
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith(f"{path}: ")


def broadcast(*shape):
    return np.broadcast_to(PIXELS[0, 0], shape)


SIP = {"CTYPE1": "RA---TAN-SIP", "CTYPE2": "DEC--TAN-SIP", "A_ORDER": 2, "B_ORDER": 2,
       "A_2_0": 1e-4, "B_0_2": 1e-4} | dict.fromkeys(
       f"{name}{k}" for name in ("CTYPE", "CRVAL", "CRPIX", "CDELT") for k in (3, 4)
)  # fmt: skip


@pytest.mark.parametrize(
    ("data", "changes", "words"),
    [
        (broadcast(4, 1, 16, 32), {"CRVAL4": -4.0}, "4 planes .* STOKES and none of"),
        (broadcast(4, 1, 16, 32), {"CRVAL4": None}, "STOKES and none of them is I"),
        (broadcast(5, 16, 32), {"CTYPE3": None}, "has 5 planes on axis 3 of the file"),
        (PIXELS[0, 0], SIP, "has distortions .SIP.; resample"),
        (PIXELS, {"CDELT1": -56.0, "CDELT2": 56.0}, "its sides are 1.79e.03 deg by CD"),
    ],
)
def test_images_that_cannot_be_used(make_fits, data, changes, words):
    refused(make_fits(data=data, **changes), words, ValueError)


def test_truncated_files_and_headers_that_claim_too_much(make_fits):
    path = make_fits()
    content = path.read_bytes()
    for keep in (1, 2880, 6000, -3000):
        path.write_bytes(content[:keep])
        refused(path, r"truncated|broken|no image")
    old = b"NAXIS1  =                   32"
    for new in (b"NAXIS1  =                99999", b"NAXIS1  =         999999999999"):
        path.write_bytes(content.replace(old, new))
        refused(path, "trunc|broken")
    old, new = (b"NAXIS   =" + text.rjust(21) for text in (b"4", b"99999999999"))
    path.write_bytes(content.replace(old, new))
    refused(path, "is broken, it claims 99999999999 axes")
    fits.writeto(path, np.ones(8), overwrite=True)
    refused(path, "holds no image$")
    Table({"x": [1.0]}).write(path, overwrite=True)
    refused(path, "holds no image but a table; make an image of events, and of a list")
    assert not looks_like_mask(np.full((2, 2), np.nan))
    # Missing padding is no loss, and files may be packed, whatever their suffix.
    path.write_bytes(content.rstrip(b"\0"))
    assert np.array_equal(read_plane(path).data, PIXELS[0, 0])
    for pack in (gzip.compress, bz2.compress, lzma.compress):
        packed = pack(content)
        path.write_bytes(packed)
        assert np.array_equal(read_plane(path).data, PIXELS[0, 0])
        for keep in (10, len(packed) // 2, len(packed) - 100):
            path.write_bytes(packed[:keep])
            refused(path, "broken")


@pytest.mark.parametrize("kind", ["RICE_1", "PLIO_1"])
def test_tile_compressed_images(make_fits, kind):
    y, x = np.mgrid[:128, :128]
    image = 1000 * np.exp(-((x - 62) ** 2 + (y - 65) ** 2) / 50)
    image = image + np.random.default_rng(1).normal(10, size=image.shape)
    exact = kind == "PLIO_1"
    image = np.rint(image.clip(0)).astype("int32") if exact else image.astype("f4")
    plain = make_fits(data=image)
    path = plain.with_suffix(".fits.fz")
    # Without a seed, the rounding is random.
    options = {"compression_type": kind, "dither_seed": 7}
    with fits.open(plain) as hdus:
        fits.CompImageHDU(hdus[0].data, hdus[0].header, **options).writeto(path)
    # Smaller than its pixels are, which it is not for being truncated.
    assert path.stat().st_size < 0.7 * plain.stat().st_size
    one, other = read_plane(plain), read_plane(path)
    # Floats are rounded to a sixteenth of the noise.
    assert np.abs(one.data - other.data).max() <= (0 if exact else 1 / 16)
    assert (other.unit, other.wcs.wcs, other.beam) == (one.unit, one.wcs.wcs, one.beam)
    assert (other.time, other.facts) == (one.time, one.facts)
    content = path.read_bytes()
    end = len(content.rstrip(b"\0"))
    for keep in (3000, len(content) // 2, len(content) - 2881, end - 1):
        path.write_bytes(content[:keep])
        refused(path, r"truncated|broken|no image")
    path.write_bytes(content[: end + 8])
    assert np.array_equal(read_plane(path).data, other.data)


def test_files_of_the_survey_and_with_quirks(shared_data):
    image = read_plane(min((shared_data / "0506+056").glob("*.fits")))
    assert (image.shape, image.facts["frequency"]) == ((512, 512), 15357490000.0)
    quirks = shared_data / "quirks"
    askap = read_plane(quirks / "3C293_askap_mid_4amin.fits")
    assert askap.beam.major.to_value(u.arcsec) == pytest.approx(28.6)
    assert read_plane(quirks / "sampling_mean.fits").unit == u.Jy / u.pix
    assert read_plane(quirks / "map_stacked.fits").facts["object"] == "J0738+17"

# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""See which features, in which epochs, make a speed."""

from pathlib import Path

from astropy.io import fits

from astro_scc.cli.inputs import read_epochs, read_table
from astro_scc.cli.program import one_line
from astro_scc.settings import Settings, read_config
from astro_scc.visualization.explore import write_explore

PAGE = "explore.html"


def run(args, reporter):
    """Write the page of a measurement according to the arguments."""
    folder = Path(args.folder)
    advice = "; name a folder that astro-scc measure has written"
    names = ("components", "features")
    tables = [read_table(folder / f"{name}.ecsv", advice) for name in names]
    try:
        hdus = fits.open(folder / "scc.fits")
    except OSError as error:
        what = "does not exist" if error.filename else "is no FITS file"
        raise OSError(f"{folder / 'scc.fits'}: {what}; measure again") from None
    with hdus:
        if "FEATURES" not in hdus or "pm_axis1" not in hdus["FEATURES"].columns.names:
            raise ValueError(
                f"{folder}: is of an earlier version, without the positions of the "
                "features; measure again"
            )
        cube, notes = _images(folder / "config.toml", hdus[0].header, reporter)
        path = write_explore(folder / PAGE, *tables, hdus, cube=cube, notes=notes)
    reporter.say(f"{path}: {path.stat().st_size / 1e6:.1f} MB")


def _images(config, header, reporter):
    """Return the epochs of a measurement, or None and a note on why there are none."""
    try:
        cube, *_ = read_epochs(Settings(**read_config(config)[0]))
        dates = cube.times.utc.isot[[0, -1]].tolist()
        measured = [header[key] for key in ("NEPOCHS", "DATE-BEG", "DATE-END")]
        if [len(cube), *dates] != measured:
            raise ValueError(f"{config}: names other epochs than those measured")
    except (OSError, ValueError) as error:
        note = f"without images: {one_line(error)}"
        reporter.note(note)
        return None, [note]
    return cube, []

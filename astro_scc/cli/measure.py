# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Measure the velocities in the images of one jet."""

from contextlib import contextmanager, nullcontext, suppress
from dataclasses import replace

from astro_scc import StackedCrossCorrelation
from astro_scc.cli import inputs
from astro_scc.cli.arguments import WORK
from astro_scc.cli.summary import component_lines
from astro_scc.measurement import write_epoch_regions, write_products
from astro_scc.measurement.products import product_folder
from astro_scc.measurement.published import published_positions
from astro_scc.measurement.tables import versions
from astro_scc.report import write_report
from astro_scc.report.page import PRODUCTS, flow_lines
from astro_scc.visualization.results import FIGURES
from astro_scc.writing import replace_when_complete

#: Products of an earlier measurement that must not remain beside new ones.
STALE = (
    *PRODUCTS,
    *(f"{kind}.{form}" for kind in FIGURES for form in ("png", "pdf")),
    *("report.html", "ssp_regions", "explore.html"),
)
SEED, MATCHES = "seed.txt", "matches.fits"


def run(args, reporter):
    """Measure according to the arguments."""
    settings = inputs.settings_of(args, reporter, n_trials=1000)
    output, overwrite = inputs.output_of(args, settings), args.overwrite
    reporter.resumes = args.resume
    with (
        working_folder(output, overwrite) if args.resume else nullcontext() as work,
        product_folder(output, overwrite=overwrite or work, stale=STALE) as folder,
    ):
        if work and settings.seed is None:
            settings = replace(settings, seed=kept_seed(work))
        epochs = inputs.read_epochs(settings, note=reporter.note)
        cube, settings, left_out, chosen = epochs
        published = args.compare and published_positions(args.compare, cube)
        n_workers = inputs.workers_of(args, cube)
        result = measure(cube, settings, reporter, n_workers=n_workers, work=work)
        page = {"left_out": left_out, "chosen": chosen, "pdf": args.pdf}
        page |= {"published": published, "all_figures": args.all_figures}
        page |= {"report": not args.no_report, "warnings": reporter.warnings}
        components = write_measurement(result, settings, folder, output=output, **page)
        if args.ds9_regions:
            write_epoch_regions(result.matched.ssps, cube, folder)
    reporter.say(
        *component_lines(components, result.features),
        *flow_lines(result),
        *epochs.found,
        f"\nTables and maps: {output}"
        if args.no_report
        else f"\nReport: {output / 'report.html'}",
    )


def measure(cube, settings, reporter, *, region=None, n_workers=1, work=None):
    """
    Measure a cube.

    Parameters
    ----------
    cube : `~astro_scc.EpochCube`
    settings : `~astro_scc.settings.Settings`
    reporter : `~astro_scc.cli.program.Reporter`
    region : path, optional
        Present path of the region file, if it will be moved.
    n_workers : int or str, optional
        See `~astro_scc.StackedCrossCorrelation.match`.
    work : `~pathlib.Path`, optional
        Folder where matches and seed are kept.

    Returns
    -------
    `~astro_scc.measurement.SCCResult`
    """
    return StackedCrossCorrelation.from_settings(settings)(
        cube,
        region=region or settings.region,
        n_trials=settings.n_trials,
        rng=settings.seed,
        n_workers=n_workers,
        cache=work and work / MATCHES,
        progress_bar=reporter.progress,
    )


def write_measurement(
    result, settings, folder, *, output, report=True, archives=True, published=None,
    **page
):  # fmt: skip
    """
    Write tables, maps, settings and report of a measurement.

    Parameters
    ----------
    result : `~astro_scc.measurement.SCCResult`
    settings : `~astro_scc.settings.Settings`
    folder : path
        Where to write.
    output : `~pathlib.Path`
        Final path of the folder.
    report : bool, optional
    archives : bool, optional
        Write the tables in the forms of journals and archives, too.
    published : `~astropy.table.QTable`, optional
        Published features to compare with.
    **page
        Arguments of `~astro_scc.report.write_report`.

    Returns
    -------
    `~astropy.table.QTable`
        The components.
    """
    how = settings.in_c
    components = result.components_in_c(**how) if how else result.components
    text = settings.to_toml(versions=versions())
    how = {"configuration": settings.to_dict(), "text": text, "published": published}
    how["archives"] = archives
    write_products(result, components, folder, **how)
    if report:
        rerun = f"astro-scc measure --config {output / 'config.toml'} -o FOLDER"
        page |= {"components": components, "rerun": rerun, "published": published}
        page["explore"] = f"astro-scc explore {output}"
        write_report(result, folder, **page)
    return components


@contextmanager
def working_folder(output, overwrite):
    """Make the folder that --resume needs; remove it if a failed run left nothing."""
    work = output / WORK
    if not (overwrite or work.is_dir()) and output.is_dir() and any(output.iterdir()):
        raise OSError(
            f"{output}: exists and is not of a run with --resume; choose another "
            "folder, or --overwrite"
        )
    made = [p for p in (work, *work.parents) if not p.exists()]
    try:
        work.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OSError(f"{output}: cannot be made or used: {error.strerror}") from None
    try:
        yield work
    except BaseException:
        # A seed alone is nothing to resume from.
        if made and {p.name for p in work.iterdir()} <= {SEED}:
            (work / SEED).unlink(missing_ok=True)
            for folder in made:
                with suppress(OSError):
                    folder.rmdir()
        raise


def kept_seed(work):
    """Return the seed of a run that may be resumed, and draw it the first time."""
    path = work / SEED
    with suppress(OSError, ValueError):
        return int(path.read_text(encoding="ascii"))
    seed = inputs.draw_seed()
    with replace_when_complete(path, overwrite=True) as part:
        part.write_text(f"{seed}\n", encoding="ascii")
    return seed

# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
Measure the velocities in the images of one jet.

Measure the velocity components in images of one object at many dates.

examples:
  astro-scc measure 3c273/*.fits --redshift 0.158
  astro-scc measure *.fits -o out --align cores.ecsv --region jet.reg \\
      --position-angle "-112 deg" --baseline "0.1 yr 0.6 yr" --redshift 0.033
  astro-scc measure m87/*.fits -o out --scales "0.2 mas, 0.4 mas" \\
      --distance "16.7 Mpc"
  astro-scc measure --config out/config.toml -o again

The folder gets components.ecsv and, for a paper, components.tex; features.ecsv,
sensitivity.ecsv, ssps.ecsv, scc.fits, report.html with its figures, and config.toml,
which reproduces the tables bit by bit from the same images.  A configuration file may
hold every option of a measurement, with _ for -, and some settings that have no option
(see the documentation).  The command line takes precedence over the file.
"""

from contextlib import contextmanager, nullcontext, suppress
from dataclasses import replace

from astro_scc.cli.arguments import (
    OF_OBJECT,
    add_output,
    add_settings,
    add_switches,
)
from astro_scc.cli.inputs import (
    draw_seed,
    measuring_time,
    output_of,
    read_epochs,
    settings_of,
    tell_time,
    workers_of,
)
from astro_scc.cli.summary import component_lines

PRODUCTS = (
    "components.ecsv features.ecsv sensitivity.ecsv ssps.ecsv components.tex scc.fits "
    "config.toml report.html streams.png diagram.png speeds.png distances.png "
    "members.png velocity_map.png significance.png epochs.png intervals.png "
    "sensitivity.png"
).split()
#: Products of an earlier measurement that must not remain beside new ones.
STALE = (
    *PRODUCTS,
    *(name.replace(".png", ".pdf") for name in PRODUCTS if name.endswith(".png")),
    *("components.vot", "ssps.vot", "ssp_regions", "explore.html"),
)
#: Folder, within the folder of the products, for what --resume keeps.
WORK = ".astro_scc-work"
SEED, MATCHES = "seed.txt", "matches.fits"


def add_arguments(parser):
    """Add the arguments of the command."""
    what, files = "tables, maps and report", "components.vot and ssps.vot"
    add_output(parser, what, default=OF_OBJECT, votable=files, report=True)
    add_switches(
        parser,
        pdf="write the figures of the report as PDF, too",
        ds9_regions="write ssp_regions too, a file per epoch that DS9 and CARTA open, "
        "with the outlines of its patterns",
        resume=f"keep the matches in {WORK} of the folder, go on from what an "
        "interrupted run did there, and replace what an earlier one with --resume "
        "wrote",
    )
    add_settings(parser, "measure")


def run(args, reporter):
    """Measure according to the arguments."""
    from astro_scc.measurement import product_folder, write_epoch_regions
    from astro_scc.measurement.products import write_votables
    from astro_scc.report.page import flow_lines

    settings = settings_of(args, reporter, n_trials=1000)
    workers_of(args)
    output, overwrite = output_of(args, settings), args.overwrite
    reporter.resumes = args.resume
    with (
        working_folder(output, overwrite) if args.resume else nullcontext() as work,
        product_folder(output, overwrite=overwrite or work, stale=STALE) as folder,
    ):
        if work and settings.seed is None:
            settings = replace(settings, seed=kept_seed(work))
        inputs = read_epochs(settings, note=reporter.note)
        cube, settings, left_out, chosen = inputs
        n_workers = workers_of(args, cube)
        if not (work and (work / MATCHES).exists()):
            tell_time(reporter, n_workers, measuring_time, cube, settings)
        result = measure(cube, settings, reporter, n_workers=n_workers, work=work)
        page = {"left_out": left_out, "chosen": chosen, "pdf": args.pdf}
        page |= {"report": not args.no_report, "warnings": reporter.warnings}
        components = write_measurement(result, settings, folder, output=output, **page)
        if args.votable:
            write_votables(result, components, folder)
        if args.ds9_regions:
            write_epoch_regions(result.matched.ssps, cube, folder)
    reporter.say(
        *component_lines(components, result.features, result.sensitivity),
        *flow_lines(result),
        *inputs.found,
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
    reporter : `~astro_scc.cli.reporter.Reporter`
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
    from astro_scc import StackedCrossCorrelation

    return StackedCrossCorrelation.from_settings(settings)(
        cube,
        region=region or settings.region,
        n_trials=settings.n_trials,
        rng=settings.seed,
        n_workers=n_workers,
        cache=work and work / MATCHES,
        progress_bar=reporter.progress,
    )


def write_measurement(result, settings, folder, *, output, report=True, **page):
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
    **page
        Arguments of `~astro_scc.report.write_report`.

    Returns
    -------
    `~astropy.table.QTable`
        The components.
    """
    from astro_scc.measurement import versions, write_products

    how = settings.in_c
    components = result.components_in_c(**how) if how else result.components
    text = settings.to_toml(versions=versions())
    write_products(
        result, components, folder, configuration=settings.to_dict(), text=text
    )
    if report:
        from astro_scc.report import write_report

        rerun = f"astro-scc measure --config {output / 'config.toml'} -o FOLDER"
        page |= {"components": components, "rerun": rerun, "config_text": text}
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
    from astro_scc.partial import replace_when_complete

    path = work / SEED
    with suppress(OSError, ValueError):
        return int(path.read_text(encoding="ascii"))
    seed = draw_seed()
    with replace_when_complete(path, overwrite=True) as part:
        part.write_text(f"{seed}\n", encoding="ascii")
    return seed

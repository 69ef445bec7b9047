# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Measure the velocities in bins of distance from the core."""

from dataclasses import asdict

from astro_scc import StackedCrossCorrelation
from astro_scc.cli import inputs
from astro_scc.flow import measure_acceleration
from astro_scc.flow.profile import bins_of, measure_profile, write_profile
from astro_scc.flow.speeds import compare_scales
from astro_scc.matching import select_ssps
from astro_scc.products.folder import product_folder
from astro_scc.products.publication import write_publication
from astro_scc.report.answer import profile_lines, scale_lines
from astro_scc.units import in_speed_unit
from astro_scc.writing import versions

PRODUCTS = (
    "profile.ecsv scales.ecsv profile.png velocity_maps.png position_angles.png "
    "config.toml publication"
).split()


def profile(args, reporter):
    """Measure a profile according to the arguments."""
    settings = inputs.settings_of(args, reporter, n_trials=1000)
    if settings.bins is None:
        raise ValueError('--bins is missing: give limits such as "0.5 1.5 2.5 mas"')
    # Wrong --bins are refused before the images are read.
    bins_of(settings.bins, window=settings.window)
    output = inputs.output_of(args, settings)
    with product_folder(output, overwrite=args.overwrite, stale=PRODUCTS) as folder:
        epochs = inputs.read_epochs(settings, args, note=reporter.note)
        components, lines = _measure(epochs, folder, reporter)
        write_publication({"profile": components}, folder)
    lines = [*profile_lines(components), "", *lines, *epochs.found]
    reporter.say(*lines, f"\nProfile: {output / 'profile.ecsv'}")


def _measure(epochs, folder, reporter):
    """Write the profile; return its components, and lines on all bins together."""
    cube, settings = epochs.cube, epochs.settings
    scc = StackedCrossCorrelation.from_settings(settings)
    shown = {"progress_bar": reporter.progress, "n_workers": epochs.n_workers}
    matched = scc.match(cube, region=settings.region, **shown)
    trials = {"n_trials": settings.n_trials, "rng": settings.seed}
    trials["progress_bar"] = reporter.progress
    ridge = scc.displacements(matched)[1] if scc.position_angle == "ridge" else None
    profile = measure_profile(
        scc, matched, settings.bins, window=settings.window, ridge=ridge, **trials
    )
    how = settings.in_c
    components = profile.components_in_c(**how) if how else profile.components
    r_min, r_max = profile.bins.min(), profile.bins.max()
    whole = scc.stack(select_ssps(matched, r_min=r_min, r_max=r_max), **trials)
    acceleration = measure_acceleration(whole)
    components.meta |= cube.facts
    components.meta["acceleration"] = asdict(acceleration)
    lines = [str(acceleration)]
    if (of_scales := compare_scales(whole)) is not None:
        in_speed_unit(of_scales, matched.cube.speed_unit)
        of_scales.write(folder / "scales.ecsv", format="ascii.ecsv")
        lines += scale_lines(of_scales)
    write_profile(
        profile, components, folder, configuration=settings.to_dict("profile"),
        text=settings.to_toml("profile", versions=versions()),
    )  # fmt: skip
    return components, lines

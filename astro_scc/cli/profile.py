# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
Measure the velocities in bins of distance from the core.

Measure the velocities in bins of distance from the core.

examples:
  astro-scc profile 3c120/*.fits -o out --align core --bins "0.5 1.5 2.5 3.5 mas" \\
      --position-angle "-112 deg" --max-speed "5 mas/yr" --redshift 0.033
  astro-scc profile m87/*.fits -o out --bins "1 2 4 8 mas" --position-angle ridge \\
      --distance "16.7 Mpc"
  astro-scc profile *.fits -o out --bins "1 2 3 4 5 mas" --window "2 mas"

All images are matched once; for each bin, the matches of its patterns are stacked.
The folder gets profile.ecsv, with a row for each bin and component, p_fdr adjusted
for all bins, and in its header the acceleration over all bins; scales.ecsv, which
compares the speeds of the finest scale and of the others; profile.png,
velocity_maps.png and position_angles.png; and config.toml.  With --position-angle
ridge, distances are measured along the ridge line.
"""

from dataclasses import asdict

from astro_scc.cli.arguments import OF_OBJECT, add_output, add_settings
from astro_scc.cli.inputs import (
    measuring_time,
    output_of,
    read_epochs,
    settings_of,
    tell_time,
    workers_of,
)
from astro_scc.cli.summary import profile_lines

PRODUCTS = (
    "profile.ecsv scales.ecsv profile.png velocity_maps.png position_angles.png "
    "config.toml profile.vot"
).split()


def add_arguments(parser):
    """Add the arguments of the command."""
    what = "the table and figures of the profile"
    add_output(parser, what, default=OF_OBJECT, votable="profile.vot")
    add_settings(parser, "profile")


def run(args, reporter):
    """Measure a profile according to the arguments."""
    from astro_scc.flow.profile import bins_of
    from astro_scc.measurement import product_folder, write_votable

    settings = settings_of(args, reporter, n_trials=1000)
    if settings.bins is None:
        raise ValueError('--bins is missing: give limits such as "0.5 1.5 2.5 mas"')
    workers_of(args)
    output = output_of(args, settings)
    n_bins = len(bins_of(settings.bins, window=settings.window))
    made = product_folder(output, overwrite=args.overwrite, stale=PRODUCTS)
    with made as folder:
        inputs = read_epochs(settings, note=reporter.note)
        cube, settings, *_ = inputs
        n_workers = workers_of(args, cube)
        tell_time(reporter, n_workers, measuring_time, cube, settings, n_bins)
        components, lines = _measure(cube, settings, folder, reporter, n_workers)
        if args.votable:
            write_votable(components, folder / "profile.vot")
    lines = [*profile_lines(components), "", *lines, *inputs.found]
    reporter.say(*lines, f"\nProfile: {output / 'profile.ecsv'}")


def _measure(cube, settings, folder, reporter, n_workers):
    """Write the profile; return its components, and lines on all bins together."""
    from astro_scc import StackedCrossCorrelation
    from astro_scc.flow import measure_acceleration
    from astro_scc.flow.groups import compare_scales
    from astro_scc.flow.profile import measure_profile, write_profile
    from astro_scc.measurement import select_ssps, versions
    from astro_scc.report.tables import scale_lines

    scc = StackedCrossCorrelation.from_settings(settings)
    shown = {"progress_bar": reporter.progress}
    trials = shown | {"n_trials": settings.n_trials, "rng": settings.seed}
    matched = scc.match(cube, region=settings.region, n_workers=n_workers, **shown)
    ridge = scc.displacements(matched)[1] if scc.position_angle == "ridge" else None
    profile = measure_profile(
        scc, matched, settings.bins, window=settings.window, ridge=ridge, **trials
    )
    how = settings.in_c
    components = profile.components_in_c(**how) if how else profile.components
    r_min, r_max = profile.bins.min(), profile.bins.max()
    whole = scc.stack(select_ssps(matched, r_min=r_min, r_max=r_max), **trials)
    acceleration = measure_acceleration(whole)
    components.meta["acceleration"] = asdict(acceleration)
    lines = [str(acceleration)]
    if (of_scales := compare_scales(whole)) is not None:
        of_scales.write(folder / "scales.ecsv", format="ascii.ecsv")
        lines += scale_lines(of_scales)
    text = settings.to_toml("profile", versions=versions())
    configuration = settings.to_dict("profile")
    write_profile(profile, components, folder, configuration=configuration, text=text)
    return components, lines

# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The parts of the data from which the main speed is measured again."""

import astropy.units as u
import numpy as np

from astro_scc.spectrum.permutations import within
from astro_scc.streams.decomposed import distances
from astro_scc.streams.parts import FEWEST_OF_HALF, part_rows
from astro_scc.units import offset_unit


def parts_of(search):
    """
    Measure the main speed from parts of the data.

    Parameters
    ----------
    search : ``StreamSearch``

    Returns
    -------
    list of dict
        See ``part_rows``; empty if nothing moves.
    """
    flow, streams = search.flow, search.streams
    moving = [k for k, s in enumerate(streams) if s.kind == "moving"]
    if not moving or search.fit is None:
        return []
    main = max(moving, key=lambda k: streams[k].share)
    parts = [*_by_interval(search), *_by_date(flow), *_by_place(flow), *_by_scale(flow)]
    return part_rows(search, main, parts)


def _by_interval(search):
    flow, (low, high) = search.flow, search.intervals
    every = np.abs(flow.years - flow.years[:, None])
    every = every[np.triu_indices(len(every), 1)]
    limit = float(np.median(every[within(every, (low, high))]))
    unit = flow.cube.speed_unit.bases[1]
    shown = f"{(limit * u.yr).to_value(unit):.2g} {unit}"
    return [
        (f"intervals up to {shown}", {"intervals": (low, limit)}),
        (f"intervals from {shown}", {"intervals": (limit, high)}),
    ]


def _by_date(flow):
    middle = len(flow.years) // 2
    if middle < FEWEST_OF_HALF:
        return []
    date = flow.cube.times[middle].strftime("%Y-%m-%d")
    return [
        (f"epochs before {date}", {"epochs": slice(middle)}),
        (f"epochs from {date} on", {"epochs": slice(middle, None)}),
    ]


def _by_place(flow):
    """Return the inner and the outer half of what is seen."""
    r, inside, region = distances(flow.grids[0]), flow.planes[0].mask, flow.regions[0]
    if region is not None:
        inside = inside & (region > 0.5)
    if not inside.any():
        return []
    border = float(np.median(r[inside]))
    unit = offset_unit(border * flow.beam)
    text = f"{(border * flow.beam * u.mas).to_value(unit):.3g} {unit}"
    inner = [(r < border) * 1.0]
    return [
        (f"inner half, up to {text}", {"places": inner}),
        (f"outer half, from {text}", {"places": [1 - own for own in inner]}),
    ]


def _by_scale(flow):
    scales = flow.planes[0].scales
    if len(scales) < 2:
        return []
    return [
        (f"{name} scales ({', '.join(f'{s:g}' for s in own)})", {"scales": tuple(own)})
        for name, own in zip(("fine", "coarse"), np.array_split(scales, 2), strict=True)
    ]

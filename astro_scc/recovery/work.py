# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The same measurement many times."""

import warnings
from concurrent.futures import ThreadPoolExecutor

from astro_scc.exceptions import MeasurementWarning
from astro_scc.progress import progress

__all__ = ["run_all"]


def run_all(function, jobs, *, n_workers=1, label="", progress_bar=False):
    """
    Call a function with each of many jobs.

    Warnings about what the data support are not repeated for each of them.

    Parameters
    ----------
    function : callable
        Takes a job.
    jobs : sequence
    n_workers : int, optional
        Number of threads.
    label : str, optional
        Of the progress bar.
    progress_bar : bool, optional

    Returns
    -------
    list
        In the order of the jobs, whatever the number of threads.

    Raises
    ------
    ValueError
        If ``n_workers`` is below 1.
    """
    from threadpoolctl import threadpool_limits

    if n_workers < 1:
        raise ValueError(f"n_workers must be at least 1, got {n_workers}")
    with (
        # Each measurement limits the threads of products by itself; limits that
        # overlap in time would be restored in the wrong order.
        threadpool_limits(1),
        warnings.catch_warnings(),
        progress(len(jobs), label, show=progress_bar) as done,
    ):
        warnings.simplefilter("ignore", MeasurementWarning)

        def work(job):
            result = function(job)
            done(1)
            return result

        if n_workers == 1:
            return [work(job) for job in jobs]
        with ThreadPoolExecutor(n_workers) as pool:
            return list(pool.map(work, jobs))

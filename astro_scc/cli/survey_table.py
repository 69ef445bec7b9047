# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""A survey of the sources of a table of components, of which images are restored."""

import json
import shutil
from contextlib import suppress
from pathlib import Path

from astro_scc.cli import restore
from astro_scc.cli.survey_sources import folder_names, read_survey
from astro_scc.epochs.components import read_sources
from astro_scc.writing import replace_when_complete

#: Folder of the images in that of the survey, and the file that names them.
IMAGES, PLAN = "images", "survey.toml"
#: Beginning of that file.
HEAD = "# Images from"


def survey_of(args, output, reporter):
    """
    Restore the images of the sources of a table, and return their survey.

    The folder of the survey gets the images of each source in ``images/NAME``, and
    ``survey.toml``, which names them.  Images that an earlier run made from the same
    table in the same way are kept.

    Parameters
    ----------
    args : `~argparse.Namespace`
        Its ``survey`` is a table that `~astro_scc.epochs.read_components` reads.
    output : `~pathlib.Path`
        Folder of the survey.
    reporter : `~astro_scc.cli.program.Reporter`

    Returns
    -------
    ``Survey``

    Raises
    ------
    ValueError
        If the images are not described, if the table lacks the source that is asked
        for, or if the images of no source can be restored.
    """
    missing = [f"--{k}" for k in ("beam", "pixel") if getattr(args, k) is None]
    if missing:
        raise ValueError(
            f"{args.survey}: a table of components needs {' and '.join(missing)} to "
            "restore images from it, as for astro-scc restore; a survey of images is "
            "a .toml file"
        )
    how = restore.images_of(args)
    options = {"source": args.source, "origin": args.origin, "beams": how["beam"]}
    found = read_sources(args.survey, **options)
    folders, path = folder_names(list(found)), output / PLAN
    state = Path(args.survey).stat()
    made_of = [str(Path(args.survey).absolute()), state.st_size, state.st_mtime_ns]
    asked = {k: str(v) for k, v in how.items() if k != "seed"}
    asked |= {"seed": args.seed, "source": args.source}
    head = f"{HEAD} {json.dumps([*made_of, asked])}"
    before = path.read_text(encoding="utf-8") if path.is_file() else ""
    # Images that were not restored here must not be deleted.
    if output.is_dir() and any(output.iterdir()) and not before.startswith(HEAD):
        raise OSError(
            f"{output}: exists and is not of a survey of a table; choose another folder"
        )
    # If the head is the same, redshifts may have been added to the file.
    if not before.startswith(f"{head}\n"):
        shutil.rmtree(output / IMAGES, ignore_errors=True)
        output.mkdir(parents=True, exist_ok=True)
        with replace_when_complete(path, overwrite=True) as part:
            tables = (
                f'[sources.{json.dumps(name)}]\nepochs = "{IMAGES}/{folder}/*.fits"\n'
                for name, folder in folders.items()
            )
            part.write_text("\n".join([head, *tables]), encoding="utf-8")
    for name, folder in folders.items():
        target = output / IMAGES / folder
        if not target.is_dir():
            try:
                restore.write_images(found[name], target, how)
            except ValueError as error:
                reporter.warn(f"{name}: no images: {error}")
    if not (output / IMAGES).is_dir():
        with suppress(OSError):
            path.unlink()
            output.rmdir()
        raise ValueError(f"{args.survey}: the images of no source can be restored")
    return read_survey(path)

# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
Show the straight lines that MOJAVE fitted to the features of the quasar 0003+380.

The tutorial compares its measurement with them::

    python benchmarks/real_images.py ../shared/data
"""

import argparse
from pathlib import Path

import numpy as np
from common import feature_motions, measured, write_table

SOURCE = "0003+380"
#: Direction from the core to the patterns of the jet, in degrees.
POSITION_ANGLE = 115.0
HEADER = ["feature", "epochs", "distance", "along the jet"]


def main():
    """Write the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument("folder", type=Path, help="of all test data")
    args = parser.parse_args()
    motions = feature_motions(args.folder / "mojave_xviii", SOURCE, POSITION_ANGLE)
    rows = [
        [
            int(motions["feature"][i]),
            len(motions["epochs"][i]),
            f"{motions['distance'][i]:.1f} mas",
            measured(motions["speed"][i], motions["error"][i], 3),
        ]
        for i in np.argsort(motions["distance"])
    ]
    write_table("real_images_fits", HEADER, rows)


if __name__ == "__main__":
    main()

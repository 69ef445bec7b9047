# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""What the command says of a file of a cube that cannot be read."""

from astropy.io import fits

from astro_scc.cli import main
from astro_scc.simulation import simulate_two_fluid


def test_a_damaged_cube_is_one_line(tmp_path, capsys):
    path = tmp_path / "cube.fits"
    simulate_two_fluid(n_epochs=2, rng=1).cube.write(path)
    with fits.open(path) as hdus:
        kept = fits.HDUList([hdu.copy() for hdu in hdus[:1]])
        kept.writeto(tmp_path / "first.fits")
    (tmp_path / "first.fits").replace(path)
    assert main(["inspect", str(path)]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    assert str(path) in err

"""Commands leave Dask alone until they use it."""

import subprocess
import sys

SCRIPT = """
import sys
from cboxlab.utils.hidden_dask import hidden_dask, show_dask
with hidden_dask():
    import numpy as np, xarray as xr
    xr.DataArray(np.ones(3), dims="x").mean()
    print(sys.modules["dask"])
    show_dask()
    import dask
    print(dask.__name__)
print(sys.modules["dask"] is dask)
with hidden_dask():
    import dask
    print(dask.__name__)
"""


def test_dask_is_hidden_until_it_is_used():
    run = subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=True)
    assert run.stdout.split() == ["None", "dask", "True", "dask"]

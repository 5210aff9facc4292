"""Whether the beliefs of many runs are what they claim to be; `errors` is read by those who load no SciPy."""

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import chdtri

from shared.scoring.errors import Floats


def nees_in_band(values: ArrayLike) -> Floats:
    """Share of dwells in which the mean NEES over runs lies in its 95 % band.

        chi2_{4n}(.025)/n <= mean <= chi2_{4n}(.975)/n,   n runs     (Bar-Shalom et al. 2001, section 5.4)

    values  : (n_run, T, ...), NaN: unknown
    returns : (...); .95 of an honest belief
    """
    found = np.asarray(values, dtype=np.float64)
    is_known = ~np.isnan(found)
    n = np.maximum(is_known.sum(axis=0), 1)
    mean = np.where(is_known, found, 0.0).sum(axis=0) / n
    # chdtri is the inverse of the upper tail
    return np.asarray(((mean >= chdtri(4.0 * n, 0.975) / n) & (mean <= chdtri(4.0 * n, 0.025) / n)).mean(axis=0))

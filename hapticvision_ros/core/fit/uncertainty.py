# Copyright 2026 The hapticvision_ros developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""
Standard errors of a least-squares fit whose residual is not white.

References
----------
.. [1] G. V. Bayley, J. M. Hammersley, "The effective number of independent observations in an
   autocorrelated time series", J. R. Stat. Soc. Suppl. 8 (1946), doi:10.2307/2983560.
.. [2] F. H. C. Marriott, J. A. Pope, "Bias in the estimation of autocorrelations", Biometrika 41
   (1954), doi:10.1093/biomet/41.3-4.390: a fitted residual looks less correlated than it is.

"""

from collections.abc import Sequence
from typing import Final

from hapticvision_ros.core.records import FloatArray
import numpy as np

_BLOCKS: Final = 256


def least_squares_covariance(jacobian: FloatArray, residuals: Sequence[FloatArray]) -> FloatArray:
    """
    Return the covariance of the parameters of a fit, corrected for autocorrelation.

    The residual is averaged over blocks, so that fast correlation (filters, mains hum) is inside a
    block; what is left between neighbouring blocks is taken for a first-order autoregression,
    whose coefficient is corrected for what the fit has taken out of the residual. The means of
    autoregressive noise forget faster than that from the second neighbour on, so that the errors
    are conservative: by up to a third where the correlation outlasts a block many times.

    Parameters
    ----------
    jacobian : ndarray, shape (n, p)
        Derivatives of the model at the n samples of all records, record after record.
    residuals : sequence of ndarray
        The residual of each record in order of time, n samples in all.

    Returns
    -------
    ndarray, shape (p, p)
        The covariance; infinite on the diagonal where the samples do not suffice for it.

    """
    parameters = jacobian.shape[1]
    means, slopes, products, squares, first = [], [], 0.0, 0.0, 0
    normal = jacobian.T @ jacobian
    scale = np.sqrt(np.diag(normal))
    scale[scale == 0.0] = 1.0
    for residual in residuals:
        edges = np.linspace(0, residual.size, min(residual.size, _BLOCKS) + 1).astype(np.intp)
        mean = np.add.reduceat(residual, edges[:-1]) / np.diff(edges)
        means.append(mean)
        record = jacobian.T[:, slice(first, first + residual.size)]
        slopes.append(np.add.reduceat(record, edges[:-1], axis=1).T / scale)
        products += float(mean[1:] @ mean[:-1])
        squares += float(mean @ mean)
        first += residual.size
    blocks = sum(mean.size for mean in means)
    if squares <= 0.0:
        return np.zeros((parameters, parameters))
    if blocks <= parameters + 4:
        return np.diag(np.full(parameters, np.inf))
    observed = (products / (blocks - len(means))) / (squares / blocks)
    fitted, length = parameters / len(means), blocks / len(means)
    correlation = (observed + fitted / length) / max(1.0 - (fitted + 2.0) / length, 0.5)
    # Below this many independent blocks the residual cannot tell its own variance.
    least = (parameters + 2.0) / blocks
    correlation = float(np.clip(correlation, 0.0, (1.0 - least) / (1.0 + least)))
    independent = blocks * (1.0 - correlation) / (1.0 + correlation)
    variance = (squares / blocks) / (1.0 - parameters / independent)
    spread = variance * sum(slope.T @ _correlate(slope, correlation) for slope in slopes)
    inverse: FloatArray = np.linalg.pinv(
        normal / np.outer(scale, scale), rcond=1e-14, hermitian=True
    )
    return np.asarray(inverse @ spread @ inverse / np.outer(scale, scale), dtype=np.float64)


def _correlate(slope: FloatArray, correlation: float) -> FloatArray:
    """Return the correlation matrix of a first-order autoregression times `slope`."""
    if correlation == 0.0:
        return slope
    lag = np.arange(slope.shape[0])
    matrix = np.power(correlation, lag)[np.abs(lag[:, np.newaxis] - lag)]
    return np.asarray(matrix @ slope, dtype=np.float64)

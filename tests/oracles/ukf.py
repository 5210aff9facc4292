"""An unscented Kalman filter of one target, as a textbook has it, to compare the particle filter with."""

import numpy as np
from numpy.typing import NDArray

from cogradar.shared.signal.array import bin_centres

Floats = NDArray[np.float64]


class UnscentedFilter:
    """Of [x, vx, y, vy] in km and km/s, dt = 1 s. A detection measures the bearing, uniform in its bin, and
    |alpha_hat| / sigma.

    Sigma points with kappa = 3 - n (Julier and Uhlmann 1997); a miss is no measurement.
    """

    def __init__(self, particles: Floats, sigma_s: float, amplitude_at_1_km: float) -> None:
        """Begin with mean and covariance of a belief, (n, 4)."""
        self.mean, self.cov = particles.mean(axis=0), np.cov(particles, rowvar=False)
        self._amplitude = amplitude_at_1_km
        self._A = np.kron(np.eye(2), [[1.0, 1.0], [0.0, 1.0]])
        gain = np.array([0.5, 1.0])
        self._Q = np.kron(np.eye(2), sigma_s**2 * np.outer(gain, gain))

    def predict(self) -> None:
        """One dwell later."""
        self.mean, self.cov = self._A @ self.mean, self._A @ self.cov @ self._A.T + self._Q

    def update(self, bin_: int, r: float, sigma: float) -> None:
        """Take a detection in, of an array with 100 bins."""
        root = np.linalg.cholesky(3.0 * (self.cov + 1e-12 * np.eye(4)))
        points = np.vstack((self.mean, self.mean + root.T, self.mean - root.T))
        weights = np.array([-1.0 / 3.0, *[1.0 / 6.0] * 8])
        range_km = np.hypot(points[:, 0], points[:, 2])
        u = self._amplitude / np.maximum(range_km, 1.0) ** 2 / sigma
        expected = np.column_stack((np.arctan2(points[:, 2], points[:, 0]), np.sqrt(u**2 + 0.5)))
        # The bins at end-fire reach half their width beyond nu = +-0.5, where there is nothing.
        low, high = np.arcsin(2.0 * np.clip(bin_centres(100)[bin_] + np.array([-0.5, 0.5]) / 99.0, -0.5, 0.5))
        noise = np.diag([(high - low) ** 2 / 12.0, 0.5])
        mean = weights @ expected
        spread = expected - mean
        innovation = (weights * spread.T) @ spread + noise
        gain = (weights * (points - self.mean).T) @ spread @ np.linalg.inv(innovation)
        self.mean = self.mean + gain @ (np.array([0.5 * (low + high), r]) - mean)
        cov = self.cov - gain @ innovation @ gain.T
        values, vectors = np.linalg.eigh(0.5 * (cov + cov.T))
        self.cov = (vectors * np.maximum(values, 1e-10)) @ vectors.T  # a negative weight can make it indefinite

"""What the columns of exported tables mean, in a line each, for formats that carry it."""

_OF_BOTH = {  # of the target; with _hat of the estimate
    "x": "position along boresight",
    "vx": "velocity along boresight",
    "y": "position across boresight, on the ground",
    "vy": "velocity across boresight, on the ground",
    "range_km": "distance from the array on the ground",
    "angle_deg": "angle from boresight",
    "nu": "direction, 0.5 sin(angle)",
    "latitude_deg": "geodetic latitude, WGS 84",
    "longitude_deg": "geodetic longitude, WGS 84",
}
_MEANINGS = {
    "k": "dwell, from 0, with the acquisition",
    "t": "dwell, from 1, after the acquisition",
    "t_s": "time of the dwell since t = 0",
    "utc_s": "time of the dwell, UTC",
    "track": "number of the track, 0: none",
    "target": "number of the target, 0: none",
    "confirmed": "whether the track is confirmed, or tentative",
    "existence": "probability that there is a target",
    "modes": "probabilities of the modes of motion",
    "z": "height of the target",
    "true_bin": "angle bin of the target, -1: not there",
    "bin": "angle bin, in scores the brightest one of the track's beams, -1: none",
    "best_bin": "angle bin that was most probable before the scan, -1: none",
    "detected": "whether the cell with the target was over its limit",
    "snr_db": "signal-to-noise ratio per virtual channel, before the array's gain",
    "statistic": "Wald-type statistic of the cell",
    "limit": "what the statistic was compared with",
    "is_over": "whether the statistic is over the limit",
    "p_fa": "probability that a cell with nothing but disturbance is over the limit",
    "alpha_hat": "estimated amplitude of the echo",
    "sigma_hat": "estimated standard deviation of the amplitude",
    "signature_power": "squared norm of what was radiated into the cell",
    "strongest": "whether it is the strongest of the rows that may be one echo",
    "nu_measured": "measured direction of the echo, 0.5 sin(angle)",
    "nu_measured_sigma": "standard deviation of the measured direction",
    "range_measured_km": "centre of the range cell of the echo",
    "range_cell_km": "width of the range cell",
    "share": "power on the track's beams, linear",
    "late": "whether the track's plan came too late, -1: unknown",
    "stale": "whether an older waveform was radiated, -1: unknown",
    "hit": "whether the target's bin was lit for the track, -1: unknown",
    "in_bin": "whether the most probable bin was the target's, -1: unknown",
    "visible": "whether a look with all power would have found the target by now with probability one half",
    "outage": "dwells in a row that the track has been out of the target's bin",
    "nees": "squared error of the state over its covariance, 4 on average if the belief is consistent",
    "nees_position": "squared error of the position over its covariance, 2 on average if the belief is consistent",
    "nees_velocity": "squared error of the velocity over its covariance, 2 on average if the belief is consistent",
    "acceleration_g": "acceleration of the target since the dwell before",
    "gospa_km": "GOSPA of all tracks and targets of the dwell",
    "gospa_localisation_km": "part of GOSPA by errors of positions",
    "gospa_missed_km": "part of GOSPA by missed targets",
    "gospa_false_km": "part of GOSPA by false tracks",
    "ospa_km": "OSPA of all tracks and targets of the dwell",
    "covariance": "covariance of [x_hat, vx_hat, y_hat, vy_hat], in km and km/s",
    "gain": "noncentrality of the statistic of the target's cell, over its beam power",
    "n_sim": "simulations behind the choice of the next bin",
    "chance": "probability that the target will be in the cell",
    "is_best": "whether the cell is in the most probable bin",
    "k_made": "dwell after which the waveform was made, -1: not stored",
    "isotropic": "power spread evenly over all directions",
    "factor": "F of the transmit covariance (isotropic / n_tx) I + F F^H",
}


def meaning_of(column: str) -> str | None:
    """What a column means, or a part of a complex one; None: it is not known here."""
    for part, which in (("_real", "real part"), ("_imag", "imaginary part")):
        if column.endswith(part) and (whole := meaning_of(column.removesuffix(part))) is not None:
            return f"{whole}, {which}"
    if (found := _MEANINGS.get(column) or _OF_BOTH.get(column)) is not None:
        return found
    estimated = _OF_BOTH.get(column.replace("_hat", "", 1)) if "_hat" in column else None
    return f"{estimated}, of the estimate" if estimated else None

"""Estimates of tracks whose plan did not come: they fly on, and are less sure."""

from typing import Any

from cogradar.services.metrics.scoring.pairing import MessageFields
from cogradar.shared.scenario.radar_config import MotionSection


def coasted(plan: MessageFields, k: int, motion: MotionSection) -> MessageFields:
    """A plan with its estimates and covariances predicted to dwell k, if it is of an earlier one."""
    if plan["k"] >= k or plan["status"] != "tracking":
        return plan
    import numpy as np  # and kernels, not imported by those who only ask for scores

    from cogradar.shared.tracking.motion import CERTAINLY_STRAIGHT, modes_after, predicted_moments

    dt = np.array([motion.dt_s * (k - plan["k"])])
    modes = modes_after(
        np.array([CERTAINLY_STRAIGHT if plan.get("modes") is None else plan["modes"]]), dt[:, np.newaxis]
    )
    found: dict[str, Any] = {}
    for of in ("", "plane_"):
        if plan.get(f"{of}estimate") is not None:
            mean, covariance = plan[f"{of}estimate"][np.newaxis], plan[f"{of}covariance"][np.newaxis]
            means, covariances = predicted_moments(mean, covariance, modes, dt, motion.sigma_s_km_s2)
            found |= {f"{of}estimate": means[0], f"{of}covariance": covariances[0]}
    return {**plan, **found}

"""The prior and what leaked into it."""

from __future__ import annotations

from collections.abc import Mapping

from .tip import Tip

PRIOR: Mapping[str, Tip] = {
    "prior.information": Tip(
        "information of the prior",
        "What the frames that left say about those that stay. Rows and columns are the tangents of poses (dp, dθ), "
        "velocities and biases, and the extrinsics; an entry off the diagonal couples two blocks.",
        equation="Λ = JᵀJ = A_kk − A_km A_mm⁻¹ A_mk",
        source="SPEC 6; seeds 003, 000.3.3.4",
    ),
    "prior.null_space": Tip(
        "null-space check",
        "Camera and IMU see neither where the window stands nor its heading: moving all of it along these four must "
        "cost nothing. Where factors were linearised at different estimates, knowledge of them is invented.",
        equation="nᵀ Λ n = 0,   n = x, y, z, yaw of the whole window",
        source="SPEC 6.2",
    ),
    "prior.leak": Tip(
        "leaked information",
        "Information that the prior holds about a direction that nothing measured.",
        equation="nᵀ Λ n",
        unit="1/m² or 1/rad²",
        frame="w",
        source="SPEC 6.2",
    ),
    "prior.sigma": Tip(
        "claimed standard deviation", "How well the prior claims to know the direction.", equation="1 / √(nᵀ Λ n)"
    ),
    **{
        f"prior.{axis}": Tip(
            f"global {axis}", f"All poses moved along {axis}.", equation=f"dp_i = e_{axis}", unit="m", frame="w"
        )
        for axis in "xyz"
    },
    "prior.yaw": Tip(
        "yaw",
        "The window turned about gravity, around the centroid of its poses.",
        equation="dp_i = e_z × (p_i − c),  dθ_i = R_iᵀ e_z,  dv_i = e_z × v_i",
        unit="rad",
        frame="w",
        source="SPEC 6.2",
    ),
}

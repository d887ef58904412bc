# SPDX-License-Identifier: MIT
"""A computed load beside the one that a closed form gives, and why they differ."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..parallel import quantile
from ..quantities import angle_text, declare, force_text

if TYPE_CHECKING:
    from .result import TestResult

declare("shear_net_deg", "shear, inextensible net", "shear angle of an inextensible net")
declare("load_net_N", "load in closed form", "load in closed form")
declare("shear_force_N_per_mm", "normalised shear force")
CAPTION = (
    "Normalised shear force over shear angle (Cao et al. 2008, Composites A 39:1037), and that of "
    "the fabric's own law."
)
SHARE = 0.9  # of the middle zone's crossovers, between the angles told
UNIFORM = 2.0  # deg between them
SMALL = 0.01  # of a load or an energy: not worth a reason


def beside_closed_form(result: TestResult) -> dict[str, Any]:
    """Figures, and a sentence, on the last state with a load in closed form. Collective.

    Empty where there is none: small displacements, specimens that are none of Cao et al. 2008.
    """
    curve, experiment = result.curve(states=True), result.experiment
    net = curve.get("load_net_N", np.empty(0))
    known = np.flatnonzero(np.isfinite(net) & (net != 0.0))
    if not len(known):
        return {}
    i = known[-1]
    load, closed = float(curve["load_N"][i]), float(net[i])
    figures: dict[str, Any] = {"load_n": closed, "load_ratio": load / closed}
    at = experiment.column.text(result.states[i].control)
    text = f"at {at} yarns that neither stretch nor bend carry {force_text(closed)} in closed form"
    if "shear_net_deg" in curve:
        figures["shear_deg"] = float(curve["shear_net_deg"][i])
        text += f", sheared by {angle_text(figures['shear_deg'])} in the middle zone"
    text += f"; computed {force_text(load)} ({100.0 * (load / closed - 1.0):+.1f} %)"
    if "shear_net_deg" in curve:
        text += f", sheared by {angle_text(curve['shear_middle_deg'][i])} (median)"
    energies = {mode: curve[f"energy_{mode}_J"][i] for mode in experiment.modes}
    total = sum(energies.values())
    names = {"bending": "yarn bending", "tension": "tension"}
    shares = [
        f"{name} has {100.0 * energies[mode] / total:.1f} %"
        for mode, name in names.items()
        if energies[mode] > SMALL * total and abs(load / closed - 1.0) > SMALL
    ]
    text += f"; of the energy {' and '.join(shares)}" if shares else ""
    if experiment.has_zones:
        angle, zone = result.states[i].fields["shear_angle"], result.zones == 0
        ends = (0.5 - 0.5 * SHARE, 0.5 + 0.5 * SHARE)
        low, high = (
            float(np.rad2deg(quantile(result.network.comm, angle[zone], end))) for end in ends
        )
        figures |= {"middle_5_deg": low, "middle_95_deg": high}
        if high - low > UNIFORM:
            width, length = experiment.size
            usual = ", as with H > 2 W," if length > 2.0 * width * (1.0 + 1e-3) else ""
            centre = angle_text(curve["shear_centre_deg"][i])
            text += (
                f". The middle zone{usual} is not uniform: {angle_text(low)} to {angle_text(high)} "
                f"on {100 * SHARE:.0f} % of it, and {centre} where a camera looks, at the centre"
            )
    return {"closed_form": figures | {"sentence": text}}

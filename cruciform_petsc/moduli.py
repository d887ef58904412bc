# SPDX-License-Identifier: MIT
"""`cruciform-petsc kilby WARP WEFT BETWEEN`: from three strips to the modulus at every angle."""

from __future__ import annotations

import logging
import math
import os
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from .calibration.kilby import Kilby
from .errors import InputError
from .output import pictures
from .output.folder import OF_KILBY, locked
from .output.saved import Result
from .output.tables import write_csv, write_json
from .parallel import on_root
from .units import format_si, to_si

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from mpi4py import MPI

WIDE = 20.0  # times the least modulus: beyond, the picture's radius is a logarithm
TOLD = 15  # degrees, between the rows on the log
FOUND = 'a strip\'s modulus is a force per width over strain, "520 N/cm", or the folder of an'


def kilby_command(
    comm: MPI.Intracomm,
    strips: tuple[str, str, str],
    log: logging.Logger,
    *,
    angle: str | None = None,
    poisson: str | None = None,
    directory: str | None = None,
) -> dict[str, Any]:
    """Tell the shear modulus, lines for a case file, and the modulus by the angle. Collective.

    ``strips`` of warp, weft and the third one are moduli, or folders of off-axis tests' results. A
    third one from a folder knows its ``angle``, by default it is 45 degrees. With a ``directory``
    kilby.json, kilby.csv and kilby.png are written there.
    """
    read = on_root(comm, lambda: [_strip(strip) for strip in strips])
    known = read[2][1]
    if known is not None and angle is not None:
        raise InputError(f'"{strips[2]}" knows the angle of its strip, leave --angle out')
    turned = to_si(angle or "45 deg", "rad", "--angle") if known is None else known
    for (_, at), wanted in zip(read[:2], (0.0, 0.5 * math.pi), strict=True):
        if at is not None and abs(math.sin(at - wanted)) > 1e-6:
            which = "warp" if wanted == 0.0 else "weft"
            raise InputError(
                f"the strip of the {which} was pulled at {format_si(at, 'rad')} to the warp: give "
                "strips along the warp, along the weft and between, in this order"
            )
    try:
        nu = float(poisson or 0.0)
    except ValueError:
        raise InputError(f'--poisson must be a number, got "{poisson}"') from None
    found = Kilby.from_strips(read[0][0], read[1][0], read[2][0], turned, nu)
    degrees = np.arange(91.0)
    moduli = found.modulus(np.deg2rad(degrees)) / 100.0
    told = {
        "warp_n_per_cm": found.warp / 100.0,
        "weft_n_per_cm": found.weft / 100.0,
        "third_n_per_cm": float(found.modulus(turned)) / 100.0,
        "third_deg": math.degrees(turned),
        "poisson": found.poisson,
        "shear_n_per_cm": found.shear_modulus / 100.0,
        "shear_error_per_error": found.error_of_shear(turned, 1.0),
    }
    log.info("shear modulus %s", format_si(found.shear_modulus, "N/m"))
    log.info(
        "              1 %% of the third strip's modulus is %.3g %% of it",
        told["shear_error_per_error"],
    )
    for line in found.lines():
        log.info("              %s", line)
    log.info("")
    log.info("angle         modulus (Kilby 1963)")
    for row in zip(degrees[::TOLD], moduli[::TOLD], strict=True):
        log.info("%4.0f deg      %.5g N/cm", *row)
    if directory is None:
        return told
    points = [(0.0, told["warp_n_per_cm"]), (90.0, told["weft_n_per_cm"])]
    points.append((told["third_deg"], told["third_n_per_cm"]))
    with locked(comm, directory, OF_KILBY, log) as folder:
        write_json(comm, folder / "kilby.json", told)
        write_csv(comm, folder / "kilby.csv", {"angle_deg": degrees, "modulus_N_per_cm": moduli})
        pictures.save(comm, folder / "kilby.png", partial(_polar, degrees, moduli, points))
        log.info("")
        log.info("results in    %s", folder)
    return told


def _strip(strip: str) -> tuple[float, float | None]:
    """Modulus [N/m], and the angle of its pull to the warp [rad] where a folder tells it."""
    if not os.path.isdir(strip):
        try:
            return to_si(strip, "N/m", "modulus"), None
        except InputError as error:
            raise InputError(f"{error}; {FOUND} off-axis-tension test") from None
    saved = Result.load(strip)
    modulus = saved.summary.get("modulus_n_per_cm")
    if saved.kind != "off-axis-tension" or not isinstance(modulus, float):
        raise InputError(f'"{strip}" is of a {saved.kind} test; {FOUND} off-axis-tension test')
    return 100.0 * modulus, saved.case.preform().bias_angle


def _polar(degrees: np.ndarray, moduli: np.ndarray, points: list[tuple[float, float]]) -> Figure:
    """Modulus over all directions of pull; the warp upwards."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5.4, 4.8), layout="constrained")
    axes: Any = figure.add_subplot(projection="polar")
    axes.set_theta_zero_location("N")
    axes.set_theta_direction(-1)
    quarter = np.concatenate([moduli, moduli[-2::-1]])
    around = np.deg2rad(np.concatenate([np.arange(181.0), np.arange(181.0, 361.0)]))
    axes.plot(around, np.concatenate([quarter, quarter[1:]]), color=pictures.COLOURS[0])
    at, size = np.array(points).T
    axes.plot(np.deg2rad(at), size, "o", color=pictures.COLOURS[1], label="strips", clip_on=False)
    if moduli.max() > WIDE * moduli.min():
        axes.set_rscale("log")
        axes.set_rlim(10.0 ** np.floor(np.log10(0.5 * moduli.min())), 1.3 * moduli.max())
    else:
        axes.set_rlim(0.0, 1.05 * moduli.max())
    axes.set_xticks(np.deg2rad(np.arange(0.0, 360.0, 45.0)))
    axes.set_xticklabels(["warp", "45°", "weft", "135°", "180°", "225°", "270°", "315°"])
    axes.set_rlabel_position(22.5)
    axes.set_title("Modulus (N/cm) by the direction of pull (Kilby 1963)")
    axes.legend(loc="lower left", bbox_to_anchor=(-0.12, -0.08))
    return figure

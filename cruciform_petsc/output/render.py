# SPDX-License-Identifier: MIT
"""Draw woven yarns off-screen with PyVista, in a process of its own; scene.py calls it.

    python -m cruciform_petsc.output.render SCENES.npz IMAGES.npz

Of its own, because VTK does not raise but abort where it cannot draw, and ranks would go with it.
"""

from __future__ import annotations

import sys

import numpy as np
import pyvista as pv

AROUND = 16  # points around a yarn
LOOK = {"ambient": 0.3, "diffuse": 0.8, "specular": 0.25, "specular_power": 15.0, "render": False}
SMOOTH_POINTS = 20_000  # of a formed blank, beyond which it is drawn as it is
STEEL = (176, 181, 188)
SMOOTH = {"smooth_shading": True, "split_sharp_edges": True, "feature_angle": 65.0}  # sharp: ends


def tubes(
    lines: np.ndarray, first: np.ndarray, half: np.ndarray, shades: np.ndarray
) -> pv.PolyData:
    """Yarns as tubes of elliptic section, with their colours (n, 3) as "shades".

    ``lines`` (n, 3) are points along all yarns, one yarn after the other; ``first`` (m,) is where
    each begins; ``half`` (n, 2), half a yarn's width in the plane, and half its height.
    """
    # VTK's tubes are round: they are made about the flat lines, then lifted and flattened.
    rows = np.split(np.arange(len(lines)), first[1:])
    cells = np.concatenate([np.append(len(row), row) for row in rows])
    flat = pv.PolyData(lines * [1.0, 1.0, 0.0], lines=cells)
    flat["wave"], flat["flatness"] = lines[:, 2], half[:, 1] / half[:, 0]
    flat["shades"], flat["half"] = shades, half[:, 0]
    tube = flat.tube(scalars="half", absolute=True, n_sides=AROUND)
    tube.points[:, 2] = tube["wave"] + tube["flatness"] * tube.points[:, 2]
    return tube


def bar(corners: np.ndarray, height: float) -> pv.PolyData:
    """Prism over a quadrangle (4, 2), half below the plane and half above."""
    bottom = np.column_stack([corners, np.full(4, -0.5 * height)])
    return pv.PolyData(bottom, [4, 0, 1, 2, 3]).extrude((0.0, 0.0, height), capping=True)


def _add_formed(plotter: pv.Plotter, scene: dict[str, np.ndarray]) -> None:
    """Cloth, lines of its yarns, and tools."""
    nearer = scene["nearer"]
    cloth = pv.PolyData.from_regular_faces(scene["points"], scene["triangles"])
    cloth["shades"] = scene["shades"].astype(float)
    halvings = int(0.5 * np.log2(max(SMOOTH_POINTS / max(cloth.n_points, 1), 1.0)))
    if halvings and cloth.n_cells:  # coarse nets drape as curves, not in facets
        cloth = cloth.subdivide(halvings, "butterfly")
    cloth["shades"] = np.clip(cloth["shades"], 0.0, 255.0).astype(np.uint8)
    cloth = cloth.translate(nearer)
    plotter.add_mesh(cloth, scalars="shades", rgb=True, smooth_shading=True, **LOOK)
    pieces = np.insert(scene["yarns"], 0, 2, axis=1)
    yarns = pv.PolyData(scene["points"] + 1.2 * nearer, lines=pieces.ravel())
    plotter.add_mesh(yarns, color="black", opacity=0.45, line_width=1.5, render=False)
    for place, looks in (("below", {}), ("above", {"opacity": 0.3})):
        points, triangles = scene[f"{place}_points"], scene[f"{place}_triangles"]
        if len(triangles) == 0:
            continue
        tools = pv.PolyData.from_regular_faces(points, triangles)
        tools = tools.clip_box(scene["box"], invert=False)
        if place == "above":
            tools = tools.clip(scene["front"], scene["middle"]).translate(2.0 * nearer)
        if tools.n_cells:
            tools = tools.extract_surface()
            plotter.add_mesh(tools, color=STEEL, **looks, **LOOK)
            rims = tools.extract_feature_edges(feature_angle=50.0)
            if rims.n_cells:
                plotter.add_mesh(rims, color="dimgray", line_width=1.5, render=False)


def render(scene: dict[str, np.ndarray], plotter: pv.Plotter) -> np.ndarray:
    """Draw on white in parallel projection; uint8 (height, width, 3), first row on top.

    In a window without lights, or one of an earlier scene with the same view.

    The scene has either ``lines``, ``first``, ``half`` and ``shades``: see `tubes`; and ``bars``
    (k, 4, 2), their ``bar_height`` and ``bar_colour``. Or a formed blank: ``points`` (n, 3),
    ``triangles`` (m, 3), ``shades`` (n, 3) and ``yarns`` (k, 2), pieces between the points; and
    tools: ``below_points`` and ``below_triangles``, ``above_points`` and ``above_triangles``, cut
    off by the ``box`` (6,), those above see-through and cut through the ``middle`` (3,) towards the
    ``front`` (3,); the cloth is moved by ``nearer`` (3,), tools above by twice that. In both:
    ``size`` (width, height) in pixels; ``focus`` (3,); ``towards`` and ``up`` (3,): from the focus
    to the camera, unit vectors; ``half_height`` of what is seen.
    Lengths in any one unit.
    """
    plotter.renderer.clear_actors()
    plotter.window_size = scene["size"].tolist()
    plotter.background_color = "white"
    if "lines" in scene:
        yarns = tubes(*(scene[name] for name in ("lines", "first", "half", "shades")))
        plotter.add_mesh(yarns, scalars="shades", rgb=True, **SMOOTH, **LOOK)
        for corners in scene["bars"]:
            prism = bar(corners, float(scene["bar_height"]))
            plotter.add_mesh(prism, color=scene["bar_colour"], **LOOK)
    else:
        _add_formed(plotter, scene)
    towards, up, focus = scene["towards"], scene["up"], scene["focus"]
    axes = 20.0 * float(scene["half_height"]) * np.array([np.cross(up, towards), up, towards])
    # From the upper left, as readers of maps and buttons expect; a weak one from the other side.
    for direction, strength in (((-0.8, 0.9, 1.0), 0.85), ((1.0, 0.0, 1.0), 0.3)):
        if len(plotter.renderer.lights) < 2:
            plotter.add_light(pv.Light(focus + direction @ axes, focus, intensity=strength))
    plotter.camera_position = [focus + axes[2], focus, up]
    plotter.enable_parallel_projection()
    plotter.parallel_scale = float(scene["half_height"])
    plotter.reset_camera_clipping_range()
    plotter.enable_anti_aliasing("ssaa")
    plotter.render()
    image = plotter.screenshot(return_img=True)
    if (image[0, 0] != 255).any():  # VTK prints what fails, and goes on
        raise OSError("VTK drew nothing")
    return image


if __name__ == "__main__":
    _, scene_file, image_file = sys.argv
    scenes: dict[str, dict[str, np.ndarray]] = {}
    with np.load(scene_file, allow_pickle=False) as data:
        for key in data:
            number, name = key.split("/")
            scenes.setdefault(number, {})[name] = data[key]
    # One window for all: a display in memory ends with the last one that closes.
    window = pv.Plotter(off_screen=True, lighting="none")
    images = {number: render(scene, window) for number, scene in scenes.items()}
    np.savez(image_file, **images)  # type: ignore[arg-type]

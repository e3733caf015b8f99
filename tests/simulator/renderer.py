"""Light through the lens: one frame's pixels from a world, a camera and a pose."""

from __future__ import annotations

import functools
import math
from typing import Dict, List, Optional, Tuple, Union

import numpy as np

from .camera import Camera, rays
from .world import GAMMA, THERMAL_RANGE_C, World

STEP = 3
EDGE_STEPS = 20
EDGE_STEP = 32
# Walls are seen at a slant: their colour is that of what stands there, averaged over this, and darker.
WALL_TEXEL_M = 0.5
WALL_LIGHT = 0.72
STEEPEST = 8.0
# Metres east and north that the lens has moved when a pixel is read, per pixel.
Moved = Tuple[np.ndarray, np.ndarray]


@functools.lru_cache(maxsize=8)
def _falloff(width: int, height: int, amount: float) -> np.ndarray:
    """Brightness over the frame: 1 in the centre, 1 - ``amount`` in the corners."""
    y = ((np.arange(height) - (height - 1) / 2) / (height / 2)) ** 2
    x = ((np.arange(width) - (width - 1) / 2) / (width / 2)) ** 2
    aspect = (height / width) ** 2
    r2 = (x[None, :] + aspect * y[:, None]) / (1 + aspect)
    return (1.0 - amount * (0.55 * r2 + 0.45 * r2 * r2)).astype(np.float32)


def _slopes(camera: Camera, rotation: np.ndarray, step: int) -> Tuple[np.ndarray, np.ndarray]:
    """Metres east and north per metre down, for every ray."""
    x, y = rays(camera, step)
    r = rotation.astype(np.float32)
    down = -(r[0, 2] * x + r[1, 2] * y + r[2, 2])
    np.maximum(down, np.float32(1.0 / (2 * STEEPEST)), out=down)
    east = (r[0, 0] * x + r[1, 0] * y + r[2, 0]) / down
    north = (r[0, 1] * x + r[1, 1] * y + r[2, 1]) / down
    return np.clip(east, -STEEPEST, STEEPEST), np.clip(north, -STEEPEST, STEEPEST)


def footprint(camera: Camera, rotation: np.ndarray, drop_m: float) -> Tuple[np.ndarray, np.ndarray]:
    """Metres east and north from the lens to where the frame's edge meets the ground ``drop_m`` below."""
    east, north = _slopes(camera, rotation, EDGE_STEP)
    edge = np.ones(east.shape, bool)
    edge[1:-1, 1:-1] = False
    return east[edge].astype(float) * drop_m, north[edge].astype(float) * drop_m


class _Heights:
    """The height grid as cv2 samples it: ray parameter -> terrain height."""

    def __init__(
        self, world: World, center: np.ndarray, east: np.ndarray, north: np.ndarray, moved: Optional[Moved] = None
    ) -> None:
        cell = np.float32(world.cell_m)
        self.grid = world.ground.height
        self.up = float(center[2])
        self.u0: Union[np.ndarray, np.float32] = np.float32((center[0] - world.west) / world.cell_m - 0.5)
        self.v0: Union[np.ndarray, np.float32] = np.float32((world.north - center[1]) / world.cell_m - 0.5)
        if moved is not None:
            self.u0, self.v0 = self.u0 + moved[0] / cell, self.v0 - moved[1] / cell
        self.du, self.dv = east / cell, -north / cell

    def at(self, z: Union[np.ndarray, float]) -> np.ndarray:
        import cv2

        drop = np.float32(self.up) - z
        u, v = self.u0 + self.du * drop, self.v0 + self.dv * drop
        return cv2.remap(self.grid, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT_101)


def _march(field: _Heights, levels: List[np.ndarray]) -> Tuple[np.ndarray, np.ndarray]:
    """First surface that each ray meets on its way down through ``levels``, as a bracket (low, high)."""
    shape = field.du.shape
    low = np.broadcast_to(levels[-1], shape).astype(np.float32)
    high = np.broadcast_to(levels[-2], shape).astype(np.float32)
    found = np.zeros(shape, bool)
    for above, z in zip(levels, levels[1:]):
        new = (field.at(z) >= z) & ~found
        low = np.where(new, z, low)
        high = np.where(new, above, high)
        found |= new
    for _ in range(5):
        middle = np.float32(0.5) * (low + high)
        under = field.at(middle) >= middle
        low = np.where(under, middle, low)
        high = np.where(under, high, middle)
    return low, high


def _moved(camera: Camera, drift_m: Tuple[float, float], step: int) -> Optional[Moved]:
    """What rows read one after another move a lens by, against the middle row; the shape of ``_slopes``."""
    if drift_m == (0.0, 0.0):
        return None
    rows = np.arange(0, camera.height + (step if step > 1 else 0), step, dtype=np.float32)
    columns = len(np.arange(0, camera.width + (step if step > 1 else 0), step))
    share = ((rows + np.float32(0.5)) / np.float32(camera.height) - np.float32(0.5))[:, None]
    full = np.broadcast_to(share, (len(rows), columns))
    return full * np.float32(drift_m[0]), full * np.float32(drift_m[1])


def hit(
    world: World,
    camera: Camera,
    rotation: np.ndarray,
    center: np.ndarray,
    drift_m: Tuple[float, float] = (0.0, 0.0),
) -> Tuple[np.ndarray, np.ndarray]:
    """Height (m) of the ground that every pixel sees, and 1 where that is a wall; float32 (height, width).

    A coarse march down every third ray finds the first surface it meets
    (roofs hide what is behind them). Where neighbouring rays agree,
    z = h(ray(z)) settles it at full resolution; where they do not, at the
    edges of roofs and trees, every single ray is marched.
    """
    import cv2

    east, north = _slopes(camera, rotation, STEP)
    field = _Heights(world, center, east, north, _moved(camera, drift_m, STEP))
    top = min(float(world.ground.height.max()), float(center[2]) - 0.5)
    bottom = float(world.ground.height.min()) - 0.01
    steepest = math.hypot(float(np.abs(east).max()), float(np.abs(north).max()))
    count = int(np.clip(math.ceil((top - bottom) * max(1.0, steepest) / 1.2), 4, 60))
    low, high = _march(field, list(np.linspace(top, bottom, count + 1).astype(np.float32)))
    coarse = np.float32(0.5) * (low + high)
    around = np.ones((3, 3), np.uint8)
    most, least = cv2.dilate(coarse, around), cv2.erode(coarse, around)
    spread = np.array([[1.0 / STEP, 0, 0], [0, 1.0 / STEP, 0]])
    size = (camera.width, camera.height)

    def full(grid: np.ndarray) -> np.ndarray:
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        return cv2.warpAffine(grid, spread, size, flags=flags, borderMode=cv2.BORDER_REPLICATE)

    z = full(coarse)
    east, north = _slopes(camera, rotation, 1)
    moved = _moved(camera, drift_m, 1)
    fine = _Heights(world, center, east, north, moved)
    for _ in range(2):
        settled = fine.at(z)
        z = np.where(np.abs(settled - z) < 0.4, settled, z)
    rough = np.flatnonzero(full((most - least > 0.6).astype(np.float32)) > 0)
    wall = np.zeros(z.shape, np.float32)
    if len(rough):
        # cv2 takes grids, not lists: fold the rough pixels into rows of a fixed length.
        rough = np.resize(rough, (-(-len(rough) // 1024), 1024))
        there = None if moved is None else (moved[0].ravel()[rough], moved[1].ravel()[rough])
        edge = _Heights(world, center, east.ravel()[rough], north.ravel()[rough], there)
        start, end = full(most).ravel()[rough] + np.float32(0.3), full(least).ravel()[rough] - np.float32(0.3)
        steps = [start + np.float32(k / EDGE_STEPS) * (end - start) for k in range(EDGE_STEPS + 1)]
        low, high = _march(edge, steps)
        exact = np.float32(0.5) * (low + high)
        z.ravel()[rough] = exact
        wall.ravel()[rough] = np.abs(edge.at(exact + np.float32(0.12)) - edge.at(exact - np.float32(0.12))) > 0.5
    return z, wall


def sample(
    world: World,
    channels: Tuple[str, ...],
    camera: Camera,
    rotation: np.ndarray,
    center: np.ndarray,
    drift_m: Tuple[float, float] = (0.0, 0.0),
) -> Tuple[np.ndarray, np.ndarray]:
    """The world's texture as the lens sees it, and the height under every pixel.

    ``drift_m`` is how far the lens moves from the first row read to the last, ``center`` where it is at the middle one.
    """
    import cv2

    z, wall = hit(world, camera, rotation, center, drift_m)
    moved = _moved(camera, drift_m, 1)
    east, north = _slopes(camera, rotation, 1)
    gsd = (float(center[2]) - float(np.median(z))) / camera.focal_px
    drop = np.float32(center[2]) - z

    def look_up(resolution_m: float) -> np.ndarray:
        texture, texel = world.layer(channels, resolution_m)
        rows = world.ground.shape[0] * world.ground.texel_m / texture.shape[0]
        u = np.float32((center[0] - world.west) / texel - 0.5) + east / np.float32(texel) * drop
        v = np.float32((world.north - center[1]) / rows - 0.5) - north / np.float32(rows) * drop
        if moved is not None:
            u, v = u + moved[0] / np.float32(texel), v - moved[1] / np.float32(rows)
        return cv2.remap(texture, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT_101)

    seen = look_up(gsd)
    if wall.any():
        share = cv2.GaussianBlur(wall, (0, 0), 0.6)
        light = np.float32(WALL_LIGHT if channels != ("thermal",) else 0.95)
        weight = share.reshape(share.shape + (1,) * (seen.ndim - 2))
        side = look_up(WALL_TEXEL_M) * light
        seen = (seen + weight * (side - seen)).astype(seen.dtype)
    return seen, z


def with_panel(texture: np.ndarray) -> np.ndarray:
    """A grey calibration panel lying in the middle, with a coded corner."""
    import cv2

    height, width = texture.shape[:2]
    full = float(np.iinfo(texture.dtype).max)
    linear = 1.0 / GAMMA if texture.dtype == np.uint8 else 1.0
    image = texture.copy()

    def square(center: Tuple[float, float], side: float, light: float) -> None:
        box = cv2.boxPoints(((center[0], center[1]), (side, side), 8.0)).astype(np.int32)
        value = full * light**linear
        cv2.fillConvexPoly(image, box, (value, value, value) if image.ndim == 3 else value)

    side = 0.30 * width
    square((0.5 * width, 0.5 * height), 1.25 * side, 0.04)
    square((0.5 * width, 0.5 * height), side, 0.5)
    code = np.random.default_rng(11).random((7, 7)) < 0.5
    cell = 0.02 * width
    for row, column in np.argwhere(code):
        square((0.14 * width + column * cell, 0.4 * height + row * cell), cell, 0.9)
    return image


_NOISE: Dict[int, np.ndarray] = {}


def _noise(gen: np.random.Generator, shape: Tuple[int, ...]) -> np.ndarray:
    """Unit noise: a window at random of one large tile (drawing it anew would cost more than the frame)."""
    side = 3072
    if side not in _NOISE:
        _NOISE[side] = np.random.default_rng(7).standard_normal((side, side), dtype=np.float32)
    flat = _NOISE[side]
    planes = []
    for _ in range(shape[2] if len(shape) == 3 else 1):
        y, x = (int(gen.integers(0, max(1, side - n))) for n in shape[:2])
        window = flat[y : y + shape[0], x : x + shape[1]]
        planes.append(window if gen.random() < 0.5 else -window)
    return np.dstack(planes) if len(shape) == 3 else planes[0]


def expose_rgb(
    texture: np.ndarray,
    gen: np.random.Generator,
    gain: float,
    offset_dn: float,
    noise_dn: float,
    blur_px: float,
    vignette: float,
) -> np.ndarray:
    """Display values of an RGB camera, uint8. ``gain`` is on light, ``offset_dn`` on the result."""
    import cv2

    image = cv2.GaussianBlur(texture, (0, 0), blur_px) if blur_px > 0.2 else texture
    fall = _falloff(image.shape[1], image.shape[0], vignette) ** np.float32(1 / GAMMA)
    value = image.astype(np.float32) * (fall * np.float32(gain ** (1 / GAMMA)))[..., None]
    value += np.float32(noise_dn) * _noise(gen, image.shape) + np.float32(offset_dn)
    return np.clip(value + 0.5, 0, 255).astype(np.uint8)


def expose_mono16(
    texture: np.ndarray,
    gen: np.random.Generator,
    gain: float,
    black: int,
    noise_dn: float,
    blur_px: float,
    vignette: float,
) -> np.ndarray:
    """Linear counts of a 12-bit sensor in 16 bits, over its black level, uint16."""
    import cv2

    image = cv2.GaussianBlur(texture, (0, 0), blur_px) if blur_px > 0.2 else texture
    value = image.astype(np.float32) * (_falloff(image.shape[1], image.shape[0], vignette) * np.float32(gain)) + black
    value += np.float32(noise_dn) * _noise(gen, image.shape)
    return (np.clip(value, 0, 65520).astype(np.uint16) >> 4) << 4


def expose_thermal(
    texture: np.ndarray, gen: np.random.Generator, noise_k: float, blur_px: float, drift_k: float
) -> np.ndarray:
    """Temperature in degrees Celsius, float32, with the core's noise and drift."""
    import cv2

    low, high = THERMAL_RANGE_C
    image = cv2.GaussianBlur(texture, (0, 0), max(blur_px, 0.3)).astype(np.float32) * np.float32((high - low) / 65535.0)
    return image + np.float32(low + drift_k) + np.float32(noise_k) * _noise(gen, image.shape)


def palette(celsius: np.ndarray, low: float, high: float, name: str) -> np.ndarray:
    """The picture that a thermal camera shows, RGB uint8: ``white-hot`` or ``ironbow``."""
    level = np.clip((celsius - low) / (high - low), 0.0, 1.0)
    if name == "white-hot":
        return np.repeat((level * 255 + 0.5).astype(np.uint8)[..., None], 3, axis=2)
    stops = np.array([0.0, 0.2, 0.45, 0.7, 0.9, 1.0])
    colours = np.array(
        [[0, 0, 20], [60, 0, 130], [190, 30, 110], [245, 130, 20], [255, 220, 90], [255, 255, 245]], float
    )
    index = (level * 255 + 0.5).astype(np.uint8)
    table = np.stack([np.interp(np.linspace(0, 1, 256), stops, colours[:, c]) for c in range(3)], axis=1)
    return np.ascontiguousarray(table.astype(np.uint8)[index])

"""Light through the lens: one frame's pixels from a world, a camera and a pose."""

from __future__ import annotations

import functools
import math
from typing import Tuple

import numpy as np

from .camera import Camera, rays
from .world import GAMMA, THERMAL_RANGE_C, World

STEP = 3
STEEPEST = 8.0


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


class _Heights:
    """The height grid as cv2 samples it: ray parameter -> terrain height."""

    def __init__(self, world: World, center: np.ndarray, east: np.ndarray, north: np.ndarray) -> None:
        cell = np.float32(world.cell_m)
        self.grid = world.ground.height
        self.up = float(center[2])
        self.u0 = np.float32((center[0] - world.west) / world.cell_m - 0.5)
        self.v0 = np.float32((world.north - center[1]) / world.cell_m - 0.5)
        self.du, self.dv = east / cell, -north / cell

    def at(self, z: "np.ndarray | float") -> np.ndarray:
        import cv2

        drop = np.float32(self.up) - z
        return cv2.remap(
            self.grid,
            self.u0 + self.du * drop,
            self.v0 + self.dv * drop,
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REFLECT_101,
        )


def hit(world: World, camera: Camera, rotation: np.ndarray, center: np.ndarray) -> np.ndarray:
    """Height (m) of the ground that every pixel sees, float32 (height, width).

    A coarse march down every third ray finds the first surface it meets
    (roofs hide what is behind them), bisection closes in, and two rounds of
    z = h(ray(z)) at full resolution settle what is not a wall.
    """
    import cv2

    east, north = _slopes(camera, rotation, STEP)
    field = _Heights(world, center, east, north)
    top = min(float(world.ground.height.max()), float(center[2]) - 0.5)
    bottom = float(world.ground.height.min())
    steepest = math.hypot(float(np.abs(east).max()), float(np.abs(north).max()))
    count = int(np.clip(math.ceil((top - bottom) * max(1.0, steepest) / 1.5), 4, 60))
    levels = np.linspace(top, bottom - 0.01, count + 1)
    low = np.full(east.shape, np.float32(levels[-1]), np.float32)
    found = np.zeros(east.shape, bool)
    for z in levels[1:]:
        now = field.at(np.float32(z)) >= np.float32(z)
        low[now & ~found] = z
        found |= now
    high = low + np.float32(levels[0] - levels[1])
    for _ in range(4):
        middle = 0.5 * (low + high)
        under = field.at(middle) >= middle
        low = np.where(under, middle, low)
        high = np.where(under, high, middle)
    coarse = np.clip(field.at(0.5 * (low + high)), low - 0.3, high + 0.3)
    spread = np.array([[1.0 / STEP, 0, 0], [0, 1.0 / STEP, 0]])
    size = (camera.width, camera.height)
    z = cv2.warpAffine(
        coarse, spread, size, flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP, borderMode=cv2.BORDER_REPLICATE
    )
    fine = _Heights(world, center, *_slopes(camera, rotation, 1))
    for _ in range(2):
        settled = fine.at(z)
        z = np.where(np.abs(settled - z) < 0.4, settled, z)
    return z


def sample(
    world: World, channels: Tuple[str, ...], camera: Camera, rotation: np.ndarray, center: np.ndarray
) -> Tuple[np.ndarray, np.ndarray]:
    """The world's texture as the lens sees it, and the height under every pixel."""
    import cv2

    z = hit(world, camera, rotation, center)
    east, north = _slopes(camera, rotation, 1)
    gsd = (float(center[2]) - float(np.median(z))) / camera.focal_px
    texture, texel = world.layer(channels, gsd)
    drop = np.float32(center[2]) - z
    rows = world.ground.shape[0] * world.ground.texel_m / texture.shape[0]
    u = np.float32((center[0] - world.west) / texel - 0.5) + east / np.float32(texel) * drop
    v = np.float32((world.north - center[1]) / rows - 0.5) - north / np.float32(rows) * drop
    return cv2.remap(texture, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT_101), z


_NOISE = {}


def _noise(gen: np.random.Generator, shape: Tuple[int, ...]) -> np.ndarray:
    """Unit noise: a window, drawn at random and turned, of one large tile (drawing it anew costs more than the frame)."""
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

"""A world to photograph: one height field and one texture per channel, by seed."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Dict, List, Sequence, Tuple

import numpy as np

from . import ground as groundwork
from .ground import Ground, fractal
from .materials import CHANNELS, GRASS, GRASS_C, ID, SOIL, SOIL_C, reflectance, temperature, texture
from .survey import ControlPoint, Scene, rng

SUN_AZIMUTH_DEG = 215.0
SUN_ELEVATION_DEG = 48.0
TARGET_M = 1.2
# 8-bit textures hold display values, so that averaging and noise look as in a camera's JPEG.
GAMMA = 2.2
THERMAL_RANGE_C = (8.0, 62.0)


@dataclass
class World:
    """Ground over ``[west, west+width] x [south, south+height]`` (m), sampled through cv2.

    ``layers`` caches mip levels by channel set and level.
    """

    scene: Scene
    seed: int
    west: float
    north: float
    ground: Ground
    layers: Dict[Tuple[Tuple[str, ...], int], np.ndarray] = field(default_factory=dict)
    shades: List[np.ndarray] = field(default_factory=list)

    @classmethod
    def make(
        cls,
        scene: Scene,
        seed: int,
        bounds: Tuple[float, float, float, float],
        texel_m: float,
        points: Sequence[ControlPoint] = (),
    ) -> "World":
        """Build the ground for ``bounds`` = west, south, east, north (m)."""
        west, south, east, north = bounds
        columns = 2 * math.ceil((east - west) / texel_m / 2)
        rows = 2 * math.ceil((north - south) / texel_m / 2)
        made = groundwork.make(rng(seed, "world", scene.key), rows, columns, texel_m, scene.relief, scene.buildings)
        world = cls(scene, seed, west, north, made)
        for point in points:
            world._paint_target(point)
        return world

    # --- heights -----------------------------------------------------------------

    @property
    def cell_m(self) -> float:
        """Cell of the height grid (m)."""
        return 2.0 * self.ground.texel_m

    def heights(self, east: np.ndarray, north: np.ndarray) -> np.ndarray:
        """Ground height (m) at points, bilinear; beyond the edge the last cell goes on."""
        grid = self.ground.height
        u = np.clip((np.asarray(east, float) - self.west) / self.cell_m - 0.5, 0, grid.shape[1] - 1.001)
        v = np.clip((self.north - np.asarray(north, float)) / self.cell_m - 0.5, 0, grid.shape[0] - 1.001)
        x, y = np.floor(u).astype(int), np.floor(v).astype(int)
        fx, fy = u - x, v - y
        top = grid[y, x] * (1 - fx) + grid[y, x + 1] * fx
        return top * (1 - fy) + (grid[y + 1, x] * (1 - fx) + grid[y + 1, x + 1] * fx) * fy

    def visible(self, point: np.ndarray, eye: np.ndarray) -> bool:
        """Nothing stands between a point (lifted by a hand's breadth) and an eye."""
        steps = np.linspace(0.0, 1.0, 400)[1:]
        line = point + np.array([0.0, 0.0, 0.1]) + steps[:, None] * (eye - point)
        below = line[:, 2] < float(self.ground.height.max())
        line = line[below]
        return not len(line) or bool(np.all(self.heights(line[:, 0], line[:, 1]) < line[:, 2]))

    def open_ground(self, gen: np.random.Generator, bounds: Tuple[float, float, float, float]) -> Tuple[float, float]:
        """A place of open, even ground (east, north) for a target."""
        west, south, east, north = bounds
        free = (ID["natural"], ID["straw"], ID["pit"], ID["stone"], ID["dirt"])
        best, best_cost = (west, south), math.inf
        for _ in range(40):
            e, n = gen.uniform(west, east), gen.uniform(south, north)
            u, v = int((e - self.west) / self.ground.texel_m), int((self.north - n) / self.ground.texel_m)
            r = int(1.5 / self.ground.texel_m)
            patch = self.ground.material[max(v - r, 0) : v + r + 1, max(u - r, 0) : u + r + 1]
            rough = self.heights(e + gen.uniform(-2, 2, 60), n + gen.uniform(-2, 2, 60))
            cost = float(np.ptp(rough)) + 20.0 * float(1 - np.isin(patch, free).mean())
            if cost < best_cost:
                best, best_cost = (e, n), cost
        return best

    def _paint_target(self, point: ControlPoint) -> None:
        """A square board of four quadrants, lying level, its centre exactly at the point."""
        t = self.ground.texel_m
        u, v = (point.east - self.west) / t, (self.north - point.north) / t
        r = TARGET_M / 2 / t
        ys, xs = np.mgrid[int(v - r) - 1 : int(v + r) + 2, int(u - r) - 1 : int(u + r) + 2]
        dx, dy = xs + 0.5 - u, ys + 0.5 - v
        inside = (np.abs(dx) <= r) & (np.abs(dy) <= r)
        dark = (dx > 0) == (dy > 0)
        self.ground.material[ys[inside], xs[inside]] = np.where(dark, ID["target-black"], ID["target-white"])[inside]
        cu, cv = u / 2 - 0.5, v / 2 - 0.5
        rc = int(TARGET_M / self.cell_m) + 1
        window = self.ground.height[int(cv) - rc : int(cv) + rc + 2, int(cu) - rc : int(cu) + rc + 2]
        window[:] = float(np.median(window))

    # --- textures ----------------------------------------------------------------

    def _shade(self) -> np.ndarray:
        """Sunlight on every texel, 0..1.2: slope against the sun and cast shadows."""
        import cv2

        if self.shades:
            return self.shades[0]
        height, cell = self.ground.height, self.cell_m
        azimuth, rise = math.radians(SUN_AZIMUTH_DEG), math.tan(math.radians(SUN_ELEVATION_DEG))
        east, north = math.sin(azimuth), math.cos(azimuth)
        dx = cv2.Sobel(height, cv2.CV_32F, 1, 0, scale=1 / (8 * cell))
        dy = cv2.Sobel(height, cv2.CV_32F, 0, 1, scale=-1 / (8 * cell))
        lambert = (rise - dx * east - dy * north) / (rise * np.sqrt(1.0 + dx * dx + dy * dy))
        lit = np.clip(0.25 + 0.75 * lambert, 0.15, 1.35)
        shadow = np.zeros(height.shape, np.float32)
        blocker = cv2.GaussianBlur(height, (0, 0), 0.6)
        distance = cell
        while distance * rise < 10.0:
            move = np.float32([[1, 0, -distance * east / cell], [0, 1, distance * north / cell]])
            moved = cv2.warpAffine(blocker, move, (height.shape[1], height.shape[0]), borderMode=cv2.BORDER_REPLICATE)
            np.maximum(shadow, np.clip((moved - distance * rise - height) * 4.0, 0.0, 1.0), out=shadow)
            distance *= 1.0 + max(cell / distance, 0.12)
        lit = cv2.GaussianBlur(lit * (1.0 - 0.62 * shadow), (0, 0), 0.5)
        shade = cv2.resize(lit, (self.ground.shape[1], self.ground.shape[0]), interpolation=cv2.INTER_LINEAR)
        self.shades = [shade, shadow]
        return shade

    def _reflective(self, channel: str) -> np.ndarray:
        """Light leaving every texel in one channel, float32 about 0..1."""
        import cv2

        ground, index = self.ground, CHANNELS.index(channel)
        own = fractal(rng(self.seed, self.scene.key, "own", channel[-4:]), ground.shape, ground.texel_m, 2.0, 0.8)
        # The plants' vigour shows in the infrared as brightness and in the red as darkness.
        vigour = {"ms-nir": 0.34, "ms-rededge": 0.16, "ms-red": -0.22, "red": -0.08}.get(channel, 0.05)
        value = (SOIL[index] * (1.0 + 0.55 * ground.tone)) * (1.0 - ground.grass)
        value += ground.grass * GRASS[index] * (1.0 + (vigour + 0.2) * ground.tone + vigour * own)
        value = np.where(ground.material == 0, value, cv2.LUT(ground.material, reflectance(channel)))
        strength = cv2.LUT(ground.material, texture())
        value *= 1.0 + strength * (0.17 * ground.detail + 0.05 * own)
        value *= self._shade()
        return np.clip(value, 0.004, 1.0)

    def _temperature(self) -> np.ndarray:
        import cv2

        ground = self.ground
        own = fractal(rng(self.seed, self.scene.key, "warmth"), ground.shape, ground.texel_m, 8.0, 0.75)
        soil = SOIL_C - 4.0 * ground.tone
        value = soil + ground.grass * (GRASS_C - soil - 2.0 * ground.tone) + 1.1 * own
        value = np.where(ground.material == 0, value, cv2.LUT(ground.material, temperature()) + 0.6 * own)
        value += 0.5 * cv2.LUT(ground.material, texture()) * ground.detail
        self._shade()
        shadow = cv2.resize(self.shades[1], (ground.shape[1], ground.shape[0]), interpolation=cv2.INTER_LINEAR)
        value -= 7.0 * shadow
        return cv2.GaussianBlur(value, (0, 0), 0.10 / ground.texel_m)

    def _base(self, channels: Tuple[str, ...]) -> np.ndarray:
        if channels == ("thermal",):
            low, high = THERMAL_RANGE_C
            return (np.clip((self._temperature() - low) / (high - low), 0, 1) * 65535).astype(np.uint16)
        if channels[0].startswith("ms-"):
            return (self._reflective(channels[0]) * 65535).astype(np.uint16)
        planes = [(255.0 * self._reflective(c) ** np.float32(1 / GAMMA) + 0.5).astype(np.uint8) for c in channels]
        return np.dstack(planes)

    def layer(self, channels: Tuple[str, ...], gsd_m: float) -> Tuple[np.ndarray, float]:
        """The texture of a channel set whose texel suits ``gsd_m``, and that texel (m).

        Levels are half octaves apart; the texel is 0.6 to 0.85 of the ground
        sampling distance, so that bilinear sampling neither blurs nor aliases.
        """
        import cv2

        level = max(0, math.floor(2.0 * math.log2(0.85 * gsd_m / self.ground.texel_m)))
        key = (channels, level)
        if key not in self.layers:
            if (channels, 0) not in self.layers:
                self.layers[channels, 0] = self._base(channels)
            base = self.layers[channels, 0]
            factor = 2.0 ** (-level / 2.0)
            size = (round(base.shape[1] * factor), round(base.shape[0] * factor))
            self.layers[key] = cv2.resize(base, size, interpolation=cv2.INTER_AREA) if level else base
        image = self.layers[key]
        return image, self.ground.texel_m * self.ground.shape[1] / image.shape[1]

    def keep_only(self, channels: Tuple[str, ...]) -> None:
        """Forget the textures of all other channel sets: each is as large as the ground."""
        for key in [k for k in self.layers if k[0] != channels]:
            del self.layers[key]

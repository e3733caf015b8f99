"""A world to photograph: one height field and one texture per channel, by seed."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Dict, List, Sequence, Tuple

import numpy as np

from . import ground as groundwork
from .ground import Ground, fractal, strips
from .materials import CHANNELS, DRY, DRY_C, GRASS, GRASS_C, ID, SOIL, SOIL_C, reflectance, temperature, texture
from .survey import ControlPoint, Scene, rng

SUN_AZIMUTH_DEG = 215.0
SUN_ELEVATION_DEG = 48.0
TARGET_M = 1.2
# A pixel averages over its own width: as a Gaussian, less what bilinear sampling adds.
PIXEL_SIGMA = 0.38
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
    points: Dict[str, ControlPoint] = field(default_factory=dict)

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
        gen = rng(seed, "targets", scene.key)
        for point in points:
            around = (point.east - 7.0, point.north - 7.0, point.east + 7.0, point.north + 7.0)
            east_m, north_m = world._open_ground(gen, around)
            # On a texel corner, so that the painted crossing is exactly at the point.
            east_m = west + texel_m * round((east_m - west) / texel_m)
            north_m = north - texel_m * round((north - north_m) / texel_m)
            world.points[point.id] = replace(point, east=east_m, north=north_m)
            world._paint_target(world.points[point.id])
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

    def _open_ground(self, gen: np.random.Generator, bounds: Tuple[float, float, float, float]) -> Tuple[float, float]:
        """A place of open, even ground (east, north) inside ``bounds``, off roofs, roads and trees."""
        west, south, east, north = bounds
        best, best_cost = ((west + east) / 2, (south + north) / 2), math.inf
        free = [ID[name] for name in ("natural", "straw", "pit", "stone", "shrub")]
        for _ in range(60):
            e, n = float(gen.uniform(west, east)), float(gen.uniform(south, north))
            u, v = int((e - self.west) / self.ground.texel_m), int((self.north - n) / self.ground.texel_m)
            r = int(1.2 / self.ground.texel_m)
            patch = self.ground.material[max(v - r, 0) : v + r + 1, max(u - r, 0) : u + r + 1]
            rough = self.heights(e + gen.uniform(-2, 2, 40), n + gen.uniform(-2, 2, 40))
            near = (
                max(math.hypot(p.east - e, p.north - n) < 3.0 for p in self.points.values()) if self.points else False
            )
            cost = float(np.ptp(rough)) + 20.0 * float(1 - np.isin(patch, free).mean()) + 50.0 * near
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
        # Level under the board, easing out to the ground around it within another board's width.
        rc = int(1.5 * TARGET_M / self.cell_m) + 1
        rows, columns = slice(int(cv) - rc, int(cv) + rc + 2), slice(int(cu) - rc, int(cu) + rc + 2)
        yy, xx = np.mgrid[rows, columns]
        reach = np.maximum(np.abs(xx - cu), np.abs(yy - cv)) * self.cell_m / TARGET_M
        window = self.ground.height[rows, columns]
        window += (np.clip(2.6 - 2.0 * reach, 0.0, 1.0) * (float(np.median(window)) - window)).astype(np.float32)

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

    def _own(self, channel: str, coarse_m: float, gain: float) -> np.ndarray:
        """What only one channel sees: noise of unit spread that no other channel shares."""
        import cv2

        rows, columns = self.ground.shape
        half = fractal(
            rng(self.seed, self.scene.key, "own", channel), (rows // 2, columns // 2), self.cell_m, coarse_m, gain
        )
        return cv2.resize(half, (columns, rows), interpolation=cv2.INTER_LINEAR)

    def _reflective(self, channel: str, out: np.ndarray, gamma: float) -> None:
        """Light leaving every texel in one channel, 0..1 to the power 1/``gamma``, over the range of ``out``."""
        import cv2

        ground, index = self.ground, CHANNELS.index(channel)
        own, shade = self._own(channel, 2.0, 0.8), self._shade()
        tables = reflectance(channel), texture()
        # The plants' vigour shows in the infrared as brightness and in the red as darkness.
        vigour = np.float32({"ms-nir": 0.18, "ms-rededge": 0.10, "ms-red": -0.14, "red": -0.05}.get(channel, 0.04))
        full = np.float32(np.iinfo(out.dtype).max)
        for rows in strips(out.shape[0]):
            material, tone, mine = ground.material[rows], ground.tone[rows], own[rows]
            value = np.float32(SOIL[index]) * (1 + np.float32(0.6) * tone)
            plants = np.float32(GRASS[index]) + np.float32(DRY[index] - GRASS[index]) * ground.dry[rows]
            plants *= 1 + (vigour + np.float32(0.2)) * tone + vigour * mine
            value += ground.grass[rows] * (plants - value)
            np.copyto(value, cv2.LUT(material, tables[0]), where=material != 0)
            fine = np.float32(0.24) * ground.detail[rows] + np.float32(0.05) * mine
            value *= (1 + cv2.LUT(material, tables[1]) * fine) * shade[rows]
            np.clip(value, np.float32(0.004), np.float32(1.0), out=value)
            out[rows] = full * (value if gamma == 1.0 else cv2.pow(value, 1.0 / gamma)) + np.float32(0.5)

    def _temperature(self, out: np.ndarray) -> None:
        """Surface temperature over ``THERMAL_RANGE_C`` as 16-bit counts."""
        import cv2

        ground = self.ground
        own = self._own("warmth", 8.0, 0.75)
        self._shade()
        shadow = cv2.resize(self.shades[1], (out.shape[1], out.shape[0]), interpolation=cv2.INTER_LINEAR)
        celsius = np.empty(out.shape, np.float32)
        for rows in strips(out.shape[0]):
            material, tone = ground.material[rows], ground.tone[rows]
            value = SOIL_C - np.float32(4.0) * tone
            plants = GRASS_C + np.float32(DRY_C - GRASS_C) * ground.dry[rows] - np.float32(2.0) * tone
            value += ground.grass[rows] * (plants - value)
            np.copyto(value, cv2.LUT(material, temperature()), where=material != 0)
            value += np.float32(0.8) * cv2.LUT(material, texture()) * ground.detail[rows]
            celsius[rows] = value + np.float32(1.1) * own[rows] - np.float32(7.0) * shadow[rows]
        celsius = cv2.GaussianBlur(celsius, (0, 0), 0.10 / ground.texel_m)
        low, high = THERMAL_RANGE_C
        for rows in strips(out.shape[0]):
            out[rows] = np.clip((celsius[rows] - low) / (high - low), 0, 1) * 65535

    def _base(self, channels: Tuple[str, ...]) -> np.ndarray:
        if channels == ("thermal",):
            counts = np.empty(self.ground.shape, np.uint16)
            self._temperature(counts)
            return counts
        if channels[0].startswith("ms-"):
            counts = np.empty(self.ground.shape, np.uint16)
            self._reflective(channels[0], counts, 1.0)
            return counts
        image = np.empty((*self.ground.shape, len(channels)), np.uint8)
        for index, channel in enumerate(channels):
            self._reflective(channel, image[..., index], GAMMA)
        return image

    def layer(self, channels: Tuple[str, ...], gsd_m: float) -> Tuple[np.ndarray, float]:
        """The texture of a channel set that suits ``gsd_m``, and its texel (m).

        Texels are 0.6 to 0.9 of the ground sampling distance and already
        averaged over what one pixel covers, so that bilinear sampling
        does not alias.
        """
        import cv2

        step = max(0, round(4.0 * math.log2(max(gsd_m / self.ground.texel_m, 1.0))))
        key = (channels, step)
        if key not in self.layers:
            if (channels, -1) not in self.layers:
                self.layers[channels, -1] = self._base(channels)
            image = self.layers[channels, -1]
            reduce = 2.0 ** (-max(0, (step - 1) // 2) / 2.0)
            if reduce < 1.0:
                size = (round(image.shape[1] * reduce), round(image.shape[0] * reduce))
                image = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
            self.layers[key] = cv2.GaussianBlur(image, (0, 0), PIXEL_SIGMA * 2.0 ** (step / 4.0) * reduce)
        image = self.layers[key]
        return image, self.ground.texel_m * self.ground.shape[1] / image.shape[1]

    def keep_only(self, channels: Tuple[str, ...]) -> None:
        """Forget the textures of all other channel sets: each is as large as the ground."""
        for key in [k for k in self.layers if k[0] != channels]:
            del self.layers[key]

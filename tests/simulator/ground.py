"""The lie of the land: noise fields, parcels, roads, buildings, trees, small things.

Everything is drawn into a ``Ground``: a height grid and, twice as fine, a
material map and the fields from which the channels are composed. Nothing in
it repeats: every shape has its own size, place and angle.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Iterator, Tuple

import numpy as np

from .materials import ID


def strips(rows: int) -> Iterator[slice]:
    """Row ranges small enough that the temporaries of array arithmetic stay in cache: a third of the time."""
    return (slice(start, min(start + 128, rows)) for start in range(0, rows, 128))


def fractal(
    gen: np.random.Generator, shape: Tuple[int, int], cell_m: float, coarse_m: float, gain: float
) -> np.ndarray:
    """Noise of unit spread from ``coarse_m`` down to the cell, each octave ``gain`` times the one above."""
    import cv2

    octaves = max(1, round(math.log2(max(coarse_m / cell_m, 1.0))) + 1)
    scale = 2 ** (octaves - 1)
    height, width = (math.ceil(n / scale) + 4 for n in shape)
    field = gen.standard_normal((height, width), dtype=np.float32)
    amplitude, power = 1.0, 1.0
    for _ in range(octaves - 1):
        field = cv2.resize(field, None, fx=2, fy=2, interpolation=cv2.INTER_CUBIC)
        amplitude *= gain
        power += amplitude * amplitude
        for rows in strips(field.shape[0]):
            field[rows] += np.float32(amplitude) * gen.standard_normal(field[rows].shape, dtype=np.float32)
    oy, ox = (field.shape[0] - shape[0]) // 2, (field.shape[1] - shape[1]) // 2
    made = np.ascontiguousarray(field[oy : oy + shape[0], ox : ox + shape[1]])
    made /= np.float32(math.sqrt(power))
    return made


def _up(field: np.ndarray, shape: Tuple[int, int]) -> np.ndarray:
    import cv2

    return cv2.resize(field, (shape[1], shape[0]), interpolation=cv2.INTER_LINEAR)


@dataclass
class Ground:
    """Grids of one piece of ground, row 0 in the north.

    ``texel_m`` is the cell of ``material``, ``grass`` (share of vegetation,
    0..1), ``dry`` (share of that which is ripe), ``detail`` (fine texture) and
    ``tone`` (slow brightness); ``height`` has cells twice as large.
    """

    texel_m: float
    material: np.ndarray
    height: np.ndarray
    grass: np.ndarray
    dry: np.ndarray
    detail: np.ndarray
    tone: np.ndarray

    @property
    def shape(self) -> Tuple[int, int]:
        return self.material.shape[0], self.material.shape[1]


def make(gen: np.random.Generator, rows: int, columns: int, texel_m: float, relief: float, buildings: float) -> Ground:
    """A new piece of ground; ``rows`` and ``columns`` are even texel counts."""
    import cv2

    shape, half = (rows, columns), (rows // 2, columns // 2)
    cell = 2.0 * texel_m
    height = 4.0 * relief * fractal(gen, half, cell, 90.0, 0.38)
    terraces = cv2.GaussianBlur(fractal(gen, half, cell, 60.0, 0.45), (0, 0), 1.2 / cell)
    height += np.float32(1.2 * relief) * (np.tanh(3.5 * terraces) + np.tanh(5.0 * (terraces - 0.9)))
    detail = fractal(gen, shape, texel_m, 12.0, 0.97)
    ground = Ground(
        texel_m=texel_m,
        material=np.zeros(shape, np.uint8),
        height=height.astype(np.float32),
        grass=np.zeros(0, np.float32),
        dry=np.zeros(0, np.float32),
        detail=detail,
        tone=np.zeros(0, np.float32),
    )
    _parcels(ground, gen)
    _litter(ground, gen)
    _roads(ground, gen)
    _buildings(ground, gen, buildings)
    _trees(ground, gen)
    ground.height += np.float32(0.05) * fractal(gen, half, cell, 3.0, 0.6)
    return ground


def _parcels(ground: Ground, gen: np.random.Generator) -> None:
    """Fields of differing cover with crooked borders."""
    import cv2

    step = 4
    low = (ground.shape[0] // step + 1, ground.shape[1] // step + 1)
    cell = ground.texel_m * step
    area = low[0] * low[1] * cell * cell
    count = max(6, round(area / 700.0))
    seeds = np.full(low, 255, np.uint8)
    seeds[gen.integers(0, low[0], count), gen.integers(0, low[1], count)] = 0
    _, labels = cv2.distanceTransformWithLabels(seeds, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    warp = [6.0 / cell * fractal(gen, low, cell, 25.0, 0.5) for _ in range(2)]
    grid_y, grid_x = np.mgrid[0 : low[0], 0 : low[1]].astype(np.float32)
    labels = cv2.remap(
        labels.astype(np.float32), grid_x + warp[0], grid_y + warp[1], cv2.INTER_NEAREST, borderMode=cv2.BORDER_REFLECT
    ).astype(np.int32)
    size = int(labels.max()) + 1
    cover = gen.beta(0.9, 0.7, size).astype(np.float32)[labels]
    tone = gen.uniform(-0.55, 0.55, size).astype(np.float32)[labels]
    dry = np.where(gen.random(size) < 0.35, gen.uniform(0.35, 1.0, size), 0.05).astype(np.float32)[labels]
    cover = cv2.GaussianBlur(cover, (0, 0), 0.5 / cell) + 0.22 * fractal(gen, low, cell, 18.0, 0.7)
    tone = cv2.GaussianBlur(tone, (0, 0), 0.4 / cell) + 0.28 * fractal(gen, low, cell, 30.0, 0.65)
    dry = cv2.GaussianBlur(dry, (0, 0), 0.3 / cell) + 0.15 * fractal(gen, low, cell, 12.0, 0.7)
    patches = fractal(gen, ground.shape, ground.texel_m, 5.0, 0.80)
    ground.grass = np.clip(_up(cover, ground.shape) + np.float32(0.26) * patches, 0.02, 0.98)
    ground.dry = np.clip(_up(dry, ground.shape), 0.0, 1.0)
    # Ploughing and mowing leave streaks, each field in its own direction.
    streaks = []
    for angle in gen.uniform(0.0, math.pi, 2):
        length = max(5, round(3.0 / ground.texel_m) | 1)
        kernel = np.zeros((length, length), np.float32)
        c, reach = length // 2, length / 2.0
        tip = (round(c + reach * math.cos(angle)), round(c + reach * math.sin(angle)))
        cv2.line(kernel, (2 * c - tip[0], 2 * c - tip[1]), tip, 1.0, 1)
        noise = gen.standard_normal((ground.shape[0] // 2, ground.shape[1] // 2), dtype=np.float32)
        streaks.append(cv2.filter2D(noise, -1, kernel / np.sqrt(kernel.sum())))
    choice = _up(cv2.GaussianBlur((gen.random(size) < 0.5).astype(np.float32)[labels], (0, 0), 2), ground.shape)
    strength = _up(cv2.GaussianBlur(gen.uniform(0.0, 0.14, size).astype(np.float32)[labels], (0, 0), 2), ground.shape)
    first, second = (_up(s, ground.shape) for s in streaks)
    ground.tone = _up(tone, ground.shape) + strength * (second + choice * (first - second))


def _spots(gen: np.random.Generator, ground: Ground, per_m2: float) -> np.ndarray:
    count = int(per_m2 * ground.shape[0] * ground.shape[1] * ground.texel_m**2)
    return np.stack((gen.uniform(0, ground.shape[1], count), gen.uniform(0, ground.shape[0], count)), axis=1)


def _litter(ground: Ground, gen: np.random.Generator) -> None:
    """Stones, tufts, molehills, bare patches, straw: small, many, none like the other."""
    import cv2

    kinds = (
        ("stone", 0.035, 0.10, 0.5),
        ("shrub", 0.060, 0.15, 0.9),
        ("pit", 0.045, 0.10, 0.6),
        ("straw", 0.025, 0.12, 0.8),
    )
    lumpy = fractal(gen, (64, 64), 1.0, 16.0, 0.7)
    for name, per_m2, smallest, largest in kinds:
        spots = _spots(gen, ground, per_m2)
        radii = smallest * (largest / smallest) ** (gen.random(len(spots)) ** 2.2) / ground.texel_m
        shape = gen.uniform(0.45, 1.0, len(spots))
        angle = gen.uniform(0.0, 180.0, len(spots))
        lumpy = np.roll(lumpy, 17, axis=1)
        where = lumpy[
            (spots[:, 1] * 64 / ground.shape[0]).astype(int), (spots[:, 0] * 64 / ground.shape[1]).astype(int)
        ]
        keep = gen.random(len(spots)) < 1.0 / (1.0 + np.exp(-1.5 * where))
        for (x, y), r, s, a in zip(spots[keep], radii[keep], shape[keep], angle[keep]):
            box = ((float(x), float(y)), (float(2 * r), float(2 * r * s)), float(a))
            corners = cv2.ellipse2Poly((int(x), int(y)), (max(1, int(r)), max(1, int(r * s))), int(a), 0, 360, 40)
            if r < 2.0:
                corners = cv2.boxPoints(box).astype(np.int32)
            cv2.fillConvexPoly(ground.material, corners, ID[name])


def _roads(ground: Ground, gen: np.random.Generator) -> None:
    """Crooked roads, tracks and a ditch that cross the ground, with cars on the roads."""
    import cv2

    rows, columns = ground.shape
    span = math.hypot(rows, columns) * ground.texel_m
    plan = (("asphalt", 5.8), ("dirt", 2.6), ("dirt", 1.6), ("asphalt", 4.4), ("water", 2.0), ("dirt", 1.2))
    for index, (name, width_m) in enumerate(plan[: 3 + round(span / 100.0)]):
        heading = gen.uniform(0, 2 * math.pi)
        through = np.array([gen.uniform(0.25, 0.75) * columns, gen.uniform(0.25, 0.75) * rows])
        step = 4.0 / ground.texel_m
        halves = []
        for sign in (1.0, -1.0):
            at, turn, bend, line = through.copy(), heading + (0.0 if sign > 0 else math.pi), 0.0, []
            for _ in range(int(1.2 * span / 4.0)):
                bend = 0.8 * bend + gen.normal(0.0, 0.035)
                turn += bend
                at = at + step * np.array([math.cos(turn), math.sin(turn)])
                line.append(at)
            halves.append(line)
        path = np.array([*halves[1][::-1], through, *halves[0]])
        points = np.round(path * 16).astype(np.int32).reshape(-1, 1, 2)
        if name == "asphalt":
            cv2.polylines(
                ground.material, [points], False, ID["dirt"], round((width_m + 1.4) / ground.texel_m), shift=4
            )
        cv2.polylines(ground.material, [points], False, ID[name], max(1, round(width_m / ground.texel_m)), shift=4)
        if name == "asphalt":
            _traffic(ground, gen, path, width_m, index)


def _traffic(ground: Ground, gen: np.random.Generator, path: np.ndarray, width_m: float, index: int) -> None:
    import cv2

    line = max(1, round(0.16 / ground.texel_m))
    at = 0
    while at < len(path) - 3:
        run = int(gen.integers(1, 4))
        if gen.random() < 0.55:
            dash = np.round(path[at : at + run + 1] * 16).astype(np.int32).reshape(-1, 1, 2)
            cv2.polylines(ground.material, [dash], False, ID["paint"], line, shift=4)
        at += run + int(gen.integers(1, 3))
    for k in range(2, len(path) - 2, 3):
        if gen.random() < 0.25:
            along = path[k + 1] - path[k - 1]
            along = along / np.linalg.norm(along)
            side = np.array([-along[1], along[0]]) * (width_m / 4 + gen.normal(0, 0.25)) / ground.texel_m
            side = side if gen.random() < 0.5 else -side
            name = ("car-red", "car-blue", "car-white", "car-black")[int(gen.integers(0, 4))]
            length, wide = gen.uniform(3.8, 5.0), gen.uniform(1.7, 2.0)
            _block(ground, path[k] + side, (length, wide), math.atan2(along[1], along[0]), ID[name], 1.4, True)
            glass = path[k] + side + along * gen.uniform(-0.5, 0.8) / ground.texel_m
            _block(
                ground, glass, (gen.uniform(0.5, 0.9), 1.5), math.atan2(along[1], along[0]), ID["car-black"], 0.0, False
            )


def _corners(center: np.ndarray, size_m: Tuple[float, float], angle: float, cell: float) -> np.ndarray:
    along = np.array([math.cos(angle), math.sin(angle)]) * size_m[0] / 2 / cell
    across = np.array([-math.sin(angle), math.cos(angle)]) * size_m[1] / 2 / cell
    return np.array(
        [center + along + across, center + along - across, center - along - across, center - along + across]
    )


def _block(
    ground: Ground,
    center: np.ndarray,
    size_m: Tuple[float, float],
    angle: float,
    material: int,
    up_m: float,
    raise_it: bool,
) -> float:
    """Paint a rotated rectangle (centre in texels) and, if asked, set it flat ``up_m`` above its mean ground."""
    import cv2

    corners = _corners(center, size_m, angle, ground.texel_m)
    cv2.fillConvexPoly(ground.material, np.round(corners * 16).astype(np.int32), material, shift=4)
    if not raise_it:
        return 0.0
    coarse = np.round((corners - 0.5) / 2 * 16).astype(np.int32)
    mask = np.zeros(ground.height.shape, np.uint8)
    cv2.fillConvexPoly(mask, coarse, 1, shift=4)
    x0, y0, w, h = cv2.boundingRect(mask)
    if w == 0 or h == 0:
        return 0.0
    window = ground.height[y0 : y0 + h, x0 : x0 + w]
    inside = mask[y0 : y0 + h, x0 : x0 + w] > 0
    top = float(window[inside].mean()) + up_m
    window[inside] = top
    return top


def _buildings(ground: Ground, gen: np.random.Generator, share: float) -> None:
    """Houses and sheds with flat roofs, things on the roofs, yards around."""
    rows, columns = ground.shape
    count = round(share * rows * columns * ground.texel_m**2 / 1500.0)
    roofs = ("roof-tile", "roof-grey", "roof-dark", "roof-white", "roof-metal", "concrete")
    for _ in range(count):
        center = np.array([gen.uniform(0.03, 0.97) * columns, gen.uniform(0.03, 0.97) * rows])
        size = (gen.uniform(6.0, 17.0), gen.uniform(5.0, 11.0))
        angle = gen.uniform(0, math.pi)
        yard = (size[0] + gen.uniform(1.0, 7.0), size[1] + gen.uniform(1.0, 6.0))
        shift = gen.normal(0, 1.2, 2) / ground.texel_m
        _block(ground, center + shift, yard, angle, ID["concrete" if gen.random() < 0.5 else "dirt"], 0.0, False)
        up = gen.uniform(3.0, 7.5)
        _block(ground, center, size, angle, ID[roofs[int(gen.integers(0, len(roofs)))]], up, True)
        along = np.array([math.cos(angle), math.sin(angle)])
        across = np.array([-along[1], along[0]])
        for _ in range(int(gen.integers(3, 12))):
            spot = along * gen.uniform(-0.42, 0.42) * size[0] + across * gen.uniform(-0.42, 0.42) * size[1]
            thing = (gen.uniform(0.3, 2.2), gen.uniform(0.3, 1.4))
            name = roofs[int(gen.integers(0, len(roofs)))]
            turn = angle if gen.random() < 0.7 else gen.uniform(0, math.pi)
            _block(ground, center + spot / ground.texel_m, thing, turn, ID[name], gen.uniform(0.2, 0.9), True)


def _trees(ground: Ground, gen: np.random.Generator) -> None:
    """Lumpy domes, in groves and alone, kept off roofs and roads."""
    cell = 2.0 * ground.texel_m
    rows, columns = ground.height.shape
    groves = fractal(gen, (48, 48), 1.0, 12.0, 0.6)
    crown = fractal(gen, (512, 512), cell, 1.2, 0.9)
    free = (ID["natural"], ID["shrub"], ID["stone"], ID["pit"], ID["straw"])
    for x, y in _spots(gen, ground, 0.012):
        grove = groves[int(y * 48 / ground.shape[0]), int(x * 48 / ground.shape[1])]
        chance, radius, up = gen.random(), gen.uniform(1.0, 3.4), gen.uniform(0.8, 1.5)
        light, ox, oy = gen.random() < 0.4, int(gen.integers(0, 380)), int(gen.integers(0, 380))
        if chance > 1.0 / (1.0 + math.exp(-3.0 * (float(grove) - 0.6))):
            continue
        if ground.material[int(y), int(x)] not in free:
            continue
        r = int(radius / cell) + 1
        cx, cy = int(x / 2), int(y / 2)
        if not (r < cx < columns - r - 1 and r < cy < rows - r - 1) or 2 * r + 1 > 130:
            continue
        yy, xx = np.mgrid[-r : r + 1, -r : r + 1].astype(np.float32)
        lumps = crown[oy : oy + 2 * r + 1, ox : ox + 2 * r + 1]
        distance = np.sqrt(xx * xx + yy * yy) * cell / radius + 0.16 * lumps
        dome = np.sqrt(np.clip(1.0 - distance**2, 0.0, 1.0)) * radius * up * 1.05 + 0.22 * lumps
        window = ground.height[cy - r : cy + r + 1, cx - r : cx + r + 1]
        leaves = (distance < 1.0) & (dome > 0)
        window[leaves] = np.maximum(window[leaves], float(ground.height[cy - r, cx - r]) + dome[leaves])
        fine = np.kron(leaves, np.ones((2, 2), bool))
        patch = ground.material[2 * (cy - r) : 2 * (cy + r + 1), 2 * (cx - r) : 2 * (cx + r + 1)]
        patch[fine] = ID["canopy-light" if light else "canopy"]

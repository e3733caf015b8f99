"""Which filter resamples truest: each against the same resize in floating point, and against frames of known detail.

    python benchmarks/resample_fidelity.py [FRAME.JPG ...] [--crop 1200]

Two references, PSNR in dB on 8-bit pixels, mean over the frames, margins left out:
"Lanczos" is a windowed sinc of three lobes in floating point without rounding
between the passes; "exact" is the frame's own spectrum, cut to the new grid or
padded with nothing (a band-limited frame, resampled without any loss).
CPU is that of one core for one megapixel of the larger side. Without a FRAME
rendered ground is used. Below each table stands what sensorgate uses.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from typing import Callable, Dict, List, Tuple

import numpy as np
from PIL import Image

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from sensorgate.stages.harmonize.resample import decode_jpeg, opencv, resize

from tests.stages.harmonize.samples import psnr, texture

Filter = Callable[[np.ndarray, Tuple[int, int]], np.ndarray]
SCALES = (0.25, 0.5, 0.67, 0.8, 0.9, 1.25, 1.5, 2.0, 3.0)
MARGIN = 24


def plain(kind: int) -> Filter:
    return lambda pixels, size: opencv().resize(pixels, size, interpolation=kind)


def by_pillow(kind: "Image.Resampling") -> Filter:
    return lambda pixels, size: np.asarray(Image.fromarray(pixels).resize(size, kind))


def filters() -> Dict[str, Filter]:
    cv2 = opencv()
    return {
        "sensorgate": resize,
        "nearest": plain(cv2.INTER_NEAREST),
        "linear": plain(cv2.INTER_LINEAR),
        "area": plain(cv2.INTER_AREA),
        "cubic": plain(cv2.INTER_CUBIC),
        "Lanczos 4": plain(cv2.INTER_LANCZOS4),
        "Pillow bicubic": by_pillow(Image.Resampling.BICUBIC),
        "Pillow Lanczos": by_pillow(Image.Resampling.LANCZOS),
    }


def lanczos(pixels: np.ndarray, size: Tuple[int, int]) -> np.ndarray:
    planes = [Image.fromarray(pixels[:, :, c].astype(np.float32)) for c in range(3)]
    return np.stack([np.asarray(p.resize(size, Image.Resampling.LANCZOS)) for p in planes], axis=-1)


def exact(pixels: np.ndarray, size: Tuple[int, int]) -> np.ndarray:
    """Resample by the discrete cosine spectrum, whose half-sample symmetric edges fit the pixel grid's half-pixel."""
    cv2 = opencv()
    height, width = pixels.shape[:2]
    keep = (min(size[0], width), min(size[1], height))
    planes = []
    for c in range(3):
        spectrum = cv2.dct(pixels[:, :, c].astype(np.float64))
        resized = np.zeros((size[1], size[0]))
        resized[: keep[1], : keep[0]] = spectrum[: keep[1], : keep[0]]
        planes.append(cv2.idct(resized) * np.sqrt(size[0] * size[1] / (width * height)))
    return np.stack(planes, axis=-1)


def inner(pixels: np.ndarray) -> np.ndarray:
    return np.clip(np.asarray(pixels, np.float64), 0, 255)[MARGIN:-MARGIN, MARGIN:-MARGIN]


def crops(files: List[Path], side: int) -> List[np.ndarray]:
    if not files:
        return [texture(side, side, seed=seed) for seed in (1, 2)]
    found = []
    for file in files:
        pixels = decode_jpeg(file.read_bytes(), grey=False)
        top, left = (max(0, (n - side) // 2) & ~1 for n in pixels.shape[:2])
        found.append(np.ascontiguousarray(pixels[top : top + side, left : left + side]))
    return found


def even(number: float) -> int:
    return 2 * round(number / 2)  # the cosine transform takes even sizes


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("frames", nargs="*", type=Path)
    parser.add_argument("--crop", type=int, default=1200)
    arguments = parser.parse_args()
    pictures = crops(arguments.frames, arguments.crop & ~1)
    for scale in SCALES:
        print(f"\nscale {scale:g}\n{'':16}{'Lanczos':>9}{'exact':>9}{'CPU s/MP':>10}")
        for name, work in filters().items():
            figures = []
            for pixels in pictures:
                size = (even(pixels.shape[1] * scale), even(pixels.shape[0] * scale))
                cpu = []
                for _ in range(3):
                    before = time.process_time()
                    result = work(pixels, size)
                    cpu.append(time.process_time() - before)
                megapixels = max(pixels.shape[0] * pixels.shape[1], size[0] * size[1]) / 1e6
                references = (lanczos(pixels, size), exact(pixels, size))
                scores = [psnr(inner(result), inner(wanted)) for wanted in references]
                figures.append([*scores, min(cpu) / megapixels])
            near, true, cost = np.mean(figures, axis=0)
            print(f"{name:16}{near:9.1f}{true:9.1f}{cost:10.4f}")


if __name__ == "__main__":
    main()

"""SOGs of random bytes, written from the format's own description."""

import io
import json

import numpy as np
from PIL import Image

RNG = np.random.default_rng(11)


def smallest_three(largest, others):
    """(N, 4) quaternions from the index of the largest component and the other three in order."""
    quats = np.zeros((len(largest), 4))
    for i, (at, three) in enumerate(zip(largest, others, strict=True)):
        quats[i, [k for k in range(4) if k != at]] = three
        quats[i, at] = np.sqrt(max(0.0, 1 - (three**2).sum()))
    return quats


def webp(values, width):
    """The bytes of a lossless WebP that holds (N, 3 or 4) bytes in raster order; the rest is black."""
    height = -(-len(values) // width)
    pixels = np.zeros((height * width, 4), np.uint8)
    pixels[:, 3] = 255
    pixels[: len(values), : values.shape[1]] = values
    file = io.BytesIO()
    Image.fromarray(pixels.reshape(height, width, 4)).save(file, "WEBP", lossless=True, exact=True)
    return file.getvalue()


def sog(version, n=37, bands=1):
    """The parts of a SOG folder of random bytes, and what they mean."""
    def bytes_(k, rows=n):
        return RNG.integers(0, 256, (rows, k), dtype=np.uint8)

    low, high, quats, scales, sh0 = bytes_(3), bytes_(3), bytes_(4), bytes_(3), bytes_(4)
    quats[:, 3] = 252 + np.arange(n) % 4
    sh0[:, 3] = np.maximum(sh0[:, 3], 1)
    coefficients, entries = (bands + 1) ** 2 - 1, 64
    centroids = bytes_(3, entries * coefficients)
    labels = RNG.integers(0, entries, n)
    mins, maxs = np.array([-2.0, -1.0, 0.0]), np.array([2.0, 1.5, 3.0])
    meta = {"means": {"shape": [n, 3], "mins": mins.tolist(), "maxs": maxs.tolist(), "files": ["l.webp", "u.webp"]},
            "quats": {"files": ["q.webp"]}, "scales": {"files": ["s.webp"]}, "sh0": {"files": ["c.webp"]},
            "shN": {"files": ["n.webp", "i.webp"]}}
    parts = {"l.webp": webp(low, 8), "u.webp": webp(high, 8), "q.webp": webp(quats, 8), "s.webp": webp(scales, 8),
             "c.webp": webp(sh0, 8), "n.webp": webp(centroids, 64 * coefficients),
             "i.webp": webp(np.stack([labels & 255, labels >> 8], axis=1).astype(np.uint8), 8)}
    log = mins + (low.astype(int) + 256 * high.astype(int)) / 65535 * (maxs - mins)
    want = {"means": np.sign(log) * np.expm1(np.abs(log)),
            "quats": smallest_three(quats[:, 3] - 252, (quats[:, :3] / 255 * 2 - 1) / np.sqrt(2))}
    entry = centroids.reshape(entries, coefficients, 3)[labels]
    if version == 1:
        meta["scales"] |= {"mins": [-9.0, -8.0, -7.0], "maxs": [-1.0, 0.0, 1.0]}
        meta["sh0"] |= {"mins": [-1.0, -2.0, -3.0, -5.0], "maxs": [1.0, 2.0, 3.0, 5.0]}
        meta["shN"] |= {"mins": -0.5, "maxs": 0.7, "quantization": 8}
        dc = np.array([-1.0, -2, -3]) * (1 - sh0[:, :3] / 127.5)
        want |= {"log_scales": np.array([-9, -8, -7]) + scales / 255 * 8, "opacity": 1 / (1 + np.exp(5 - sh0[:, 3] / 25.5)),
                 "dc": dc, "rest": -0.5 + entry / 255 * 1.2}
    else:
        books = {key: np.sort(RNG.normal(size=256)) for key in ("scales", "sh0", "shN")}
        for key, book in books.items():
            meta[key]["codebook"] = book.tolist()
        meta |= {"version": 2, "count": n}
        meta["shN"] |= {"bands": bands, "count": entries}
        want |= {"log_scales": books["scales"][scales], "opacity": sh0[:, 3] / 255, "dc": books["sh0"][sh0[:, :3]],
                 "rest": books["shN"][entry]}
    return parts | {"meta.json": json.dumps(meta).encode()}, want


def write_folder(folder, parts):
    folder.mkdir(parents=True)
    for name, data in parts.items():
        (folder / name).write_bytes(data)
    return folder

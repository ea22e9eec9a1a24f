#!/usr/bin/env python3
"""Time to equal noise of light-map bakers: ours here and now, others from their recorded results.

    bake.py OCCLUDE SCENE.gltf... --recorded results-bake.jsonl [--density D] [--bounces 6] [--out DIR]

Every scene is baked at several numbers of directions, by bundles and by paths, without denoiser, and compared with two converged bakes of
the same way (other seeds): squared error (t - r1)(t - r2), free of the references' own noise, relative to the
mean; over texels that are valid and not on a chart's border. Seconds are processor time over cores: what the wall clock would show on a
machine that does nothing else. Texels differ from program to program (each lays out its own), so a program's seconds are scaled to
the same number of texels. Needs numpy and OpenEXR.
"""
import argparse
import json
import os
import resource
import subprocess

import numpy as np
import OpenEXR


def channels(path):
    with OpenEXR.File(path, separate_channels=True) as f:
        return {name: np.asarray(c.pixels, np.float64) for name, c in f.channels().items()}


def bake(args, scene, out, *options):
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [args.occlude, "bake", scene, "-o", out, "--bounces", str(args.bounces), "--texels-per-metre", str(args.density), *options,
               "--stats", out + ".json"]
    subprocess.run(command, check=True, stdin=subprocess.DEVNULL)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    seconds = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    pages = [channels(os.path.join(out, p["file"])) for p in json.load(open(os.path.join(out, "manifest.json")))["pages"]]
    # What was gathered, before borders are filled and seams closed.
    values = [np.stack([p.get("raw." + c, p[c]) for c in "RGB"], -1) for p in pages]
    valid = [p["validity.V"] > 0.99 for p in pages]
    return seconds, values, [inner(v) for v in valid]


def inner(m):
    p = np.pad(m, 1)
    h, w = m.shape
    return np.logical_and.reduce([p[1 + y:1 + y + h, 1 + x:1 + x + w] for y in (-1, 0, 1) for x in (-1, 0, 1)])


def errors(test, r1, r2, valid):
    t, a, b = (np.concatenate([p[m] for p, m in zip(x, valid)]) for x in (test, r1, r2))
    mean = (a + b).mean() / 2
    t, a, b = t / mean, a / mean, b / mean
    relative = ((t - a) * (t - b) / (((a + b) / 2) ** 2 + 1e-2)).mean()
    # Blocks of 8 x 8 texels: error that neighbours share, which the eye sees as stains.
    blocks = []
    for x, y, z, m in zip(test, r1, r2, valid):
        h, w = (s // 8 * 8 for s in m.shape)
        cut = lambda v: v[:h, :w].reshape(h // 8, 8, w // 8, 8, -1)
        full = cut(m[..., None]).all((1, 3))[..., 0]
        x, y, z = (cut(v).mean((1, 3))[full] / mean for v in (x, y, z))
        blocks.append(((x - y) * (x - z) / (((y + z) / 2) ** 2 + 1e-2)).ravel())
    return relative, np.concatenate(blocks).mean(), len(t)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("occlude")
    parser.add_argument("scenes", nargs="+")
    parser.add_argument("--recorded", required=True)
    parser.add_argument("--density", type=float, default=70)
    parser.add_argument("--bounces", type=int, default=6)
    parser.add_argument("--directions", default="16,64,256")
    parser.add_argument("--reference", type=int, default=2048)
    parser.add_argument("--out", default="bake-peers")
    args = parser.parse_args()
    os.makedirs(args.out, exist_ok=True)
    others = [json.loads(line) for line in open(args.recorded)]
    for scene in args.scenes:
        name = os.path.basename(scene).split(".")[0].removesuffix("_lm")
        rows = []
        for gather in ("bundles", "path"):
            path = lambda what: os.path.join(args.out, f"{name}-{gather}-{what}")
            references = [bake(args, scene, path(f"ref{seed}"), "--gather", gather, "--directions", str(args.reference), "--seed", str(seed))
                          for seed in (101, 102)]
            for n in args.directions.split(","):
                seconds, values, valid = bake(args, scene, path(n), "--gather", gather, "--directions", n, "--seed", "1")
                error, blocks, texels = errors(values, references[0][1], references[1][1], valid)
                rows.append((f"{gather} {n}", seconds / os.cpu_count(), texels, error, blocks))
        for other in others:
            if other.get("scene_key", "").startswith(name) and "OIDN" not in other["name"]:
                rows.append((other["name"], other["cpu_s"] / 2, other["texels"], other["relmse"], None))
        texels = max(row[2] for row in rows)
        for label, seconds, count, error, blocks in rows:
            scaled = seconds * texels / count
            block = f" blocks {blocks:.2e}" if blocks is not None else ""
            print(f"{name:<10} {label:<18} {scaled:8.2f} s  relMSE {error:.2e}  relMSE x s {error * scaled:.3f}{block}", flush=True)


if __name__ == "__main__":
    main()

#!/usr/bin/env python3
"""Run `occlude render` as one program among others in a comparison, and print its cost in one line.

  occlude_render.py OCCLUDE SCENE OUT.exr --seed 1 --spp 16 [--res 512x512] [--segments 8] [-- OPTION...]

--segments counts path segments as many renderers do: 1 is emission seen directly, 2 adds direct light; occlude counts
scattering events, one less. Options after `--` go to occlude as they are. The last line of output is

  RESULT {"seconds": build + work, "work_s", "build_s", "load_s", "cpu_s": of the whole process, "mean": [r, g, b] ...}
"""
import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile

ap = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
ap.add_argument("occlude"); ap.add_argument("scene"); ap.add_argument("out")
ap.add_argument("--seed", default="1"); ap.add_argument("--spp", default="16")
ap.add_argument("--res", default="512x512"); ap.add_argument("--segments", type=int, default=8)
own = sys.argv[1:]
extra = []
if "--" in own:
    own, extra = own[:own.index("--")], own[own.index("--") + 1:]
a = ap.parse_args(own)
with tempfile.TemporaryDirectory() as folder:
    stats = os.path.join(folder, "stats.json")
    command = [a.occlude, "render", a.scene, "-o", a.out, "--size", a.res, "--samples", a.spp, "--seed", a.seed,
               "--max-depth", str(a.segments - 1), "--stats", stats, *extra]
    done = subprocess.run(command, stdout=subprocess.DEVNULL)
    if done.returncode:
        sys.exit(done.returncode)
    with open(stats) as f:
        s = json.load(f)
use = resource.getrusage(resource.RUSAGE_CHILDREN)
t = s["seconds"]
print("RESULT " + json.dumps({
    "program": "occlude", "commit": s.get("commit"), "spp": s.get("samples_per_pixel"), "seconds": t["build"] + t["work"],
    "work_s": t["work"], "build_s": t["build"], "load_s": t["load"], "cpu_s": round(use.ru_utime + use.ru_stime, 3),
    "peak_bytes": s["memory"]["peak_bytes"], "rays": s["rays"], "visibility": s["visibility"]}))

#!/usr/bin/env python3
"""Bakes a scene on many machines (or processes) with dask.distributed. The result is byte for byte that of one machine.

    bake_dask.py SCENE OUTDIR [--parts N] [--scheduler ADDRESS] [--occlude PROGRAM] [--work DIR] [-- OPTIONS OF occlude bake]

Every round of the bake is cut into N parts; when all are done they are merged, and the next round starts from that.
Without --scheduler a local cluster of N single-threaded processes is started. The scene and --work must be on a file system
that all workers see.
"""
import argparse
import json
import os
import subprocess
import sys


def run(command):
    """One command on some worker; its errors become ours."""
    done = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(f"{' '.join(command)}: exit code {done.returncode}: {done.stderr.strip()}")
    return done.stdout


def main():
    arguments, options = sys.argv[1:], []
    if "--" in arguments:
        at = arguments.index("--")
        arguments, options = arguments[:at], arguments[at + 1:]
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene")
    parser.add_argument("output")
    parser.add_argument("--parts", type=int, default=4)
    parser.add_argument("--scheduler")
    parser.add_argument("--occlude", default="occlude")
    parser.add_argument("--work")
    args = parser.parse_args(arguments)

    from dask.distributed import Client, LocalCluster

    scene, output = os.path.abspath(args.scene), os.path.abspath(args.output)
    work = os.path.abspath(args.work or output + ".parts")
    os.makedirs(work, exist_ok=True)
    cluster = None
    if not args.scheduler:
        cluster = LocalCluster(n_workers=args.parts, threads_per_worker=1, dashboard_address=None)
        options = options + ["--threads", "1"]
    with Client(args.scheduler or cluster) as client:
        after = []
        for number in range(1000):
            parts = [os.path.join(work, f"part{i}") for i in range(args.parts)]
            commands = [
                [args.occlude, "bake", scene, "-o", part, "--shard", f"{i}/{args.parts}", *options, *after]
                for i, part in enumerate(parts)
            ]
            client.gather(client.map(run, commands, pure=False))
            merged = os.path.join(work, f"round{number + 1}")
            told = run([args.occlude, "merge", *parts, "-o", merged])
            if json.loads(told)["finished"]:
                os.makedirs(output, exist_ok=True)
                for name in os.listdir(merged):
                    os.replace(os.path.join(merged, name), os.path.join(output, name))
                break
            after = ["--after", merged]
    if cluster:
        cluster.close()


if __name__ == "__main__":
    main()

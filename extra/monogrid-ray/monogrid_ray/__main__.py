"""The command: `monogrid-ray recordings.tsv --out s3://bucket/maps`."""

import argparse
import sys
from collections import Counter

import ray

from .driver import Batch, run
from .terminal import printable


def arguments() -> argparse.Namespace:
    """What it was called with."""
    parser = argparse.ArgumentParser(prog="monogrid-ray", description=__doc__)
    parser.add_argument("list", help="list of recordings as `monogrid batch` has them, - for standard input; sources may be addresses (s3://, gs://, az://, file://)")
    parser.add_argument("--out", required=True, help="a folder that all computers see, or an address in an object store")
    parser.add_argument("--address", help="address of a Ray cluster, or auto [default: this computer alone]")
    parser.add_argument("--workers", type=int, help="tasks at once on this computer alone [default: its processors]")
    parser.add_argument("--cpus", type=float, default=1, help="processors of a task [1]")
    parser.add_argument("--each", action="append", default=[], metavar="KEY=VALUE", help="option of `monogrid run` for all recordings")
    parser.add_argument("--timeout", type=float, metavar="S", help="stop a run that takes longer")
    parser.add_argument("--retry", default="", metavar="CLASS,...", help="do recordings of these classes again although nothing has changed")
    parser.add_argument("--retries", type=int, default=20, help="how often a task is begun again when its worker is lost [20]")
    parser.add_argument("--program", default="monogrid", help="the program, on all computers [monogrid]")
    parser.add_argument("--scratch", default=Batch.scratch, help="folder for what is fetched and not yet sent, the same on all computers")
    return parser.parse_args()


def main() -> None:
    """Does a batch; exit code 0 when every recording has a result, whatever it is, else 1."""
    args = arguments()
    with sys.stdin if args.list == "-" else open(args.list, encoding="utf-8") as file:
        lines = file.read().splitlines()
    if args.address:
        ray.init(address=args.address, log_to_driver=False)
    else:
        ray.init(num_cpus=args.workers and max(1, round(args.workers * args.cpus)), include_dashboard=False, log_to_driver=False)
    retry = [name for name in args.retry.split(",") if name]
    batch = Batch(lines, args.out, args.program, args.each, args.timeout, retry, args.cpus, args.retries, args.scratch)
    records = run(batch)
    classes = Counter(record["class"] for record in records.values())
    counts = ", ".join(f"{count} {name}" for name, count in sorted(classes.items()))
    print(printable(f"{len(records)} recordings in {args.out}: {counts}"))
    planned = len({line for line in lines if line.strip() and not line.startswith("#")})
    sys.exit(0 if len(records) >= planned else 1)


if __name__ == "__main__":
    main()

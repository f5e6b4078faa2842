"""Claim: PyTorch's loader with 2 workers reads 300 frames (rgb and depth, 320²) per second or more.

The second claim: the first batch of a data set at a remote URL arrives within 2 s.

A data set of a generated colon is made for it: 8 patients, one recording of a camera each. Batches
are of 8 frames, shuffled. Local files are in the memory of the operating system. The remote URL is
of a web server in a separate process on the same machine, which waits before each answer for as
long as a network would; its data set is read from `vrcaps.data.open` to the first batch, with
nothing kept from before.

    python -m benchmarks.speed.reading [--size 100]
"""

from __future__ import annotations

import functools
import http.server
import multiprocessing
import os
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from typing import Any

from benchmarks.common.scripts import options, table, write_section

BATCH, WORKERS, CHANNELS = 8, 2, ("rgb", "depth")
SECONDS, ROUNDS = 4.0, 5
"""Measured time for each rate [s]; number of measurements of the first batch."""
LATENCIES_MS = (1, 20, 50)
MIN_RATE, MAX_SECONDS = 300.0, 2.0
PLAN = """
capsule = "mirocam"
channels = ["rgb", "depth"]
frames = {frames}
organ = {{ name = "colon", seed = 1 }}
motion = {{ drift = {{ uniform = [0.0, 0.3] }} }}

[dataset]
name = "reading"
patients = 8
split = {{ train = 1.0, val = 0.0, test = 0.0 }}
"""
HEAD = ("reader", "frames per second", "processor time per frame", "claimed")
HEAD_REMOTE = ("delay of each answer", "first batch", "frames per second after it", "claimed")


def main() -> None:
    """Make the data set, measure, write the tables."""
    args = options(__doc__ or "", size=100)
    with tempfile.TemporaryDirectory() as scratch:
        folder = made_dataset(Path(scratch), args.size)
        rows = [row(name, *rate(loader)) for name, loader in local_loaders(folder)]
        remote = [remote_row(folder, latency) for latency in LATENCIES_MS]
    text = f"""## Reading speed

8 recordings of {args.size} frames, rgb and depth, 320 × 320; batches of {BATCH}, shuffled; \
{os.cpu_count()} processors.
Claimed: {MIN_RATE:.0f} frames per second with {WORKERS} workers.

{table(HEAD, rows)}

From a web server that waits before each answer, {WORKERS} workers of 8 threads; median of \
{ROUNDS} (lowest–highest).
Claimed: the first batch in less than {MAX_SECONDS:.0f} s, from `vrcaps.data.open` on.

{table(HEAD_REMOTE, remote)}
"""
    write_section(args.out, Path(__file__), text)


def made_dataset(folder: Path, frames: int) -> Path:
    """Record the data set in this process."""
    from vrcaps.cli import main as run

    plan, out = folder / "plan.toml", folder / "dataset"
    plan.write_text(PLAN.format(frames=frames))
    run(["dataset", "make", str(plan), "--out", str(out), "--workers", "0"])
    return out


def local_loaders(folder: Path) -> Iterator[tuple[str, Any]]:
    """Readers of batches of the local data set, by name."""
    from torch.utils.data import DataLoader

    from vrcaps.data import FrameStream, FrameWindows
    from vrcaps.data import open as open_dataset

    sequences = open_dataset(folder).sequences("train")
    frames = FrameWindows(sequences, CHANNELS)
    more = {"batch_size": BATCH, "num_workers": WORKERS, "persistent_workers": True}
    yield "no worker", DataLoader(frames, batch_size=BATCH, shuffle=True)
    yield f"`FrameWindows`, {WORKERS} workers", DataLoader(frames, shuffle=True, **more)
    yield f"`FrameStream`, {WORKERS} workers", DataLoader(FrameStream(frames), **more)
    windows = FrameWindows(sequences, CHANNELS, length=3)
    yield f"windows of 3 frames, {WORKERS} workers", DataLoader(windows, shuffle=True, **more)
    depth = FrameWindows(sequences, CHANNELS[1:])
    yield f"depth alone, {WORKERS} workers", DataLoader(depth, shuffle=True, **more)


def rate(loader: Any) -> tuple[float, float]:
    """Frames per second after a first pass, and processor time [s] per frame in all processes.

    The workers' start is in neither.
    """
    for _ in loader:
        pass
    used, count, begin = processor_time(loader), 0, time.perf_counter()
    while (elapsed := time.perf_counter() - begin) < SECONDS:
        count += sum(batch["index"].numel() for batch in loader)
    return count / elapsed, (processor_time(loader) - used) / count


def processor_time(loader: Any) -> float:
    """Processor time of this process and of a loader's workers so far [s]."""
    workers = getattr(loader._iterator, "_workers", ())
    ticks = sum(
        sum(map(int, Path(f"/proc/{worker.pid}/stat").read_text().split()[13:15]))
        for worker in workers
    )
    return time.process_time() + ticks / os.sysconf("SC_CLK_TCK")


def row(name: str, found: float, used: float) -> tuple[str, ...]:
    """Row of the table of local files; the claim concerns frames with workers."""
    verdict = ("yes" if found >= MIN_RATE else "NO") if name.startswith("`") else ""
    return name, f"{found:.0f}", f"{used * 1e3:.2f} ms", verdict


def remote_row(folder: Path, latency_ms: float) -> tuple[str, ...]:
    """A line of the table of the remote URL."""
    with served(folder, latency_ms * 1e-3) as url:
        found = sorted(first_batch(url) for _ in range(ROUNDS))
    seconds, rates = [one[0] for one in found], sorted(one[1] for one in found)
    middle = seconds[len(seconds) // 2]
    return (
        f"{latency_ms} ms",
        f"{middle:.2f} s ({seconds[0]:.2f}–{seconds[-1]:.2f})",
        f"{rates[len(rates) // 2]:.0f} ({rates[0]:.0f}–{rates[-1]:.0f})",
        "yes" if middle < MAX_SECONDS else "NO",
    )


def first_batch(url: str) -> tuple[float, float]:
    """Seconds until the first batch of a data set, and frames per second of 40 batches after it."""
    from torch.utils.data import DataLoader

    from vrcaps.data import FrameWindows, store
    from vrcaps.data import open as open_dataset

    store._connection.cache_clear()  # as a process that begins
    begin = time.perf_counter()
    sequences = open_dataset(url).sequences("train")
    windows = FrameWindows(sequences, CHANNELS, threads=8)
    batches = iter(DataLoader(windows, BATCH, shuffle=True, num_workers=WORKERS))
    next(batches)
    first = time.perf_counter() - begin
    count = sum(len(batch["index"]) for batch in islice(batches, 40))
    return first, count / (time.perf_counter() - begin - first)


@contextmanager
def served(folder: Path, latency: float) -> Iterator[str]:
    """URL of a folder served by another process, which waits for a time [s] before each answer."""
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=serve, args=(folder, latency, theirs), daemon=True)
    process.start()
    try:
        yield f"http://127.0.0.1:{ours.recv()}"
    finally:
        process.terminate()
        process.join()


def serve(folder: Path, latency: float, connection: Any) -> None:
    """Serve a folder, and report the port."""

    class Handler(http.server.SimpleHTTPRequestHandler):
        protocol_version = "HTTP/1.1"  # connections stay open

        def do_GET(self) -> None:
            time.sleep(latency)
            super().do_GET()

        def log_message(self, *_: Any) -> None:
            pass

    handler = functools.partial(Handler, directory=str(folder))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        connection.send(server.server_address[1])
        server.serve_forever()


if __name__ == "__main__":
    main()

"""What the peer programs share: our weights file as NumPy arrays, position codes, and timing as in encoder_bench."""
import json
import struct
import time

import numpy as np

LINKS, SAMPLES = 9, 20


def read(path):
    """(tensors by name, configuration) of a safetensors file; our files hold F32 only."""
    with open(path, "rb") as file:
        data = file.read()
    (length,) = struct.unpack_from("<Q", data)
    header = json.loads(data[8:8 + length])
    metadata = header.pop("__metadata__")
    tensors = {}
    for name, entry in header.items():
        first, last = entry["data_offsets"]
        numbers = np.frombuffer(data, "<f4", offset=8 + length + first, count=(last - first) // 4)
        tensors[name] = numbers.reshape(entry["shape"])
    return tensors, json.loads(metadata["config"])


def position_code(width):
    """[180][width]: row t * 9 + l is (sin, cos of l; sin, cos of t)."""
    frequency = 10000.0 ** (-np.arange(width // 4) / (width // 4))
    token = np.arange(SAMPLES * LINKS)
    link, moment = np.outer(token % LINKS, frequency), np.outer(token // LINKS, frequency)
    return np.hstack([np.sin(link), np.cos(link), np.sin(moment), np.cos(moment)]).astype(np.float32)


def measure(work, runs):
    """20 warm-ups, then `runs` timed: the same figures as encoder_bench."""
    for _ in range(20):
        work()
    times = []
    for _ in range(runs):
        start = time.perf_counter()
        work()
        times.append(1e3 * (time.perf_counter() - start))
    times.sort()
    at = lambda q: times[min(len(times) - 1, int(q * len(times)))]
    return {"median_ms": at(0.5), "p99_ms": at(0.99), "p999_ms": at(0.999), "minimum_ms": times[0]}


def report(peer, precision, threads, figures, difference):
    print(json.dumps({"peer": peer, "precision": precision, "threads": threads, "difference": difference, **figures}),
          flush=True)

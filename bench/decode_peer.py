"""Records a second of csiread: decode_peer.py LOG.dat SECONDS. Prints one JSON object. See bench/decode."""
import json
import pathlib
import sys
import time

import csiread


def records_per_second(work, seconds):
    """Median over as many passes as fit, by processor time, as google-benchmark counts it."""
    rates = []
    end = time.perf_counter() + seconds
    while time.perf_counter() < end or len(rates) < 3:
        start = time.process_time()
        records = work()
        rates.append(records / (time.process_time() - start))
    return sorted(rates)[len(rates) // 2]


def most_streams(path):
    """csiread wants to be told; byte 9 of a CSI record's body says."""
    log, at, streams = pathlib.Path(path).read_bytes(), 0, 1
    while at + 13 <= len(log):
        if log[at + 2] == 0xBB:
            streams = max(streams, log[at + 12])
        at += 2 + int.from_bytes(log[at:at + 2], "big")
    return streams


def main():
    path, seconds = sys.argv[1], float(sys.argv[2])
    reader = csiread.Intel(path, nrxnum=3, ntxnum=most_streams(path), pl_size=128, if_report=False)

    def read():
        reader.read()
        return reader.count

    def read_and_scale():
        reader.read()
        reader.get_scaled_csi(inplace=True)
        return reader.count

    print(json.dumps({
        "version": csiread.__version__,
        "file_to_records": records_per_second(read, seconds),
        "file_to_scaled": records_per_second(read_and_scale, seconds),
    }))


if __name__ == "__main__":
    main()

"""Measures what the live page's server does for one browser that draws at once: pictures and bytes a second, simulated
frames, processor time.

    python tools/measure_view.py [SCENE] [--seconds 10] [--color speed]
"""

from __future__ import annotations

import argparse
import asyncio
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import aiohttp
from fastcollide.view.messages import HEADER

ROOT = Path(__file__).parent.parent


def processor_seconds(process: int) -> float:
    """What a process has used so far, all threads together [s]."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


async def watch(address: str, process: int, seconds: float, color: str) -> dict[str, float]:
    """Takes pictures for so long, after one second to get going."""
    address = address.replace("/?", "/socket?")
    async with aiohttp.ClientSession() as session, session.ws_connect(address, max_msg_size=0) as socket:
        await socket.send_json({"type": "color", "by": color})
        pictures = bytes_taken = 0
        first_frame = last_frame = spheres = 0
        started, used = None, 0.0
        begin = time.perf_counter() + 1.0
        async for message in socket:
            now = time.perf_counter()
            if message.type != aiohttp.WSMsgType.BINARY:
                continue
            await socket.send_json({"type": "ack"})
            _, last_frame, _, _, spheres, _, _ = HEADER.unpack_from(message.data)
            if started is None:
                if now >= begin:
                    started, used, first_frame = now, processor_seconds(process), last_frame
                continue
            pictures += 1
            bytes_taken += len(message.data)
            if now - started >= seconds:
                break
        length = now - started
        return {
            "spheres": spheres,
            "pictures/s": pictures / length,
            "MB/s": bytes_taken / length / 1e6,
            "simulated frames/s": (last_frame - first_frame) / length,
            "processor ms a picture": 1000 * (processor_seconds(process) - used) / pictures,
        }


def main() -> None:
    """Starts the program with a scene, watches it, prints what was found."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scene", nargs="?", default=str(ROOT / "scenes" / "report_20000.toml"))
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--color", default="speed", choices=["speed", "radius", "id", "contacts"])
    options = parser.parse_args()
    command = [sys.executable, "-u", "-m", "fastcollide.cli", "view", options.scene, "--port", "0", "--no-browser"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        try:
            address = next(found[0] for line in server.stdout if (found := re.search(r"http\S+", line)))
            for name, value in asyncio.run(watch(address, server.pid, options.seconds, options.color)).items():
                print(f"{name:<26}{value:,.2f}")
        finally:
            server.send_signal(signal.SIGINT)


if __name__ == "__main__":
    main()

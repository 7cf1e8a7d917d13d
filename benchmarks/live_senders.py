"""Sources on the loopback: a film sent again and again over UDP, RTSP or HTTP, each picture when it is time for it.

    python benchmarks/live_senders.py KIND FILM PORT SECONDS LOG

Every picture's number and when its last byte was handed to the system (``time.monotonic``, which all processes share) goes into
LOG.
"""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from fractions import Fraction
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any, TextIO

JPEG_QUALITY = 92


def paced(film: Path, seconds: float) -> Iterator[tuple[Any, int, Any]]:
    """Packets of a film, again and again: the packet's bytes, its number, its stream; each when it is time for it."""
    import av

    with av.open(str(film)) as source:
        stream = source.streams.video[0]
        packets = [(bytes(p), bool(p.is_keyframe)) for p in source.demux(stream) if p.size]
        rate = float(stream.average_rate)
        began = time.monotonic()
        for number in range(round(seconds * rate)):
            time.sleep(max(began + number / rate - time.monotonic(), 0.0))
            yield packets[number % len(packets)], number, stream


def send_packets(film: Path, address: str, form: str, options: dict[str, str], seconds: float, log: TextIO) -> None:
    """By ffmpeg's own libraries, without coding anew."""
    import av

    target, out = None, None
    for (data, key), number, stream in paced(film, seconds):
        if target is None:
            target = av.open(address, "w", format=form, options=options)
            out = target.add_stream_from_template(stream)
        rate = stream.average_rate
        packet = av.Packet(data)
        packet.pts = packet.dts = number
        packet.time_base, packet.is_keyframe, packet.stream = Fraction(1) / rate, key, out
        target.mux(packet)
        log.write(f"{number} {time.monotonic():.6f}\n")
    if target is not None:
        with suppress(Exception):
            target.close()


def jpegs(film: Path, most: int = 1_000_000) -> tuple[list[bytes], float]:
    """The film's pictures as JPEG, and their rate."""
    import av
    import cv2

    with av.open(str(film)) as source:
        rate = float(source.streams.video[0].average_rate)
        pictures = []
        for frame in source.decode(video=0):
            if len(pictures) == most:
                break
            pictures.append(
                cv2.imencode(".jpg", frame.to_ndarray(format="bgr24"), [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[
                    1
                ].tobytes()
            )
    return pictures, rate


def serve_jpegs(
    pictures: list[bytes],
    rate_hz: float,
    port: int,
    seconds: float,
    sent: Callable[[int], None] = lambda _: None,
    spans: tuple[tuple[float, float], ...] = (),
    zero_s: float | None = None,
) -> ThreadingHTTPServer:
    """A server of an MJPEG stream, running; every reader gets the film from its beginning.

    Parameters
    ----------
    pictures, rate_hz : of ``jpegs``
    port : 0: one that is free (``server_port``)
    seconds : of the stream
    sent : told each picture's number when its last byte is sent
    spans : times, s, in which the line is cut: a reader is closed at a beginning and sees pictures again after the end
    zero_s : monotonic time of the first picture, which a reader may miss; None: when the first reader asks
    """
    began: list[float] = [] if zero_s is None else [zero_s]

    class Stream(BaseHTTPRequestHandler):
        def log_message(self, format: str, *args: object) -> None:
            pass

        def do_GET(self) -> None:
            self.send_response(200)
            self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=frame")
            self.end_headers()
            began[:] = began or [time.monotonic()]
            first = max(round((time.monotonic() - began[0]) * rate_hz), 0)
            with suppress(OSError):
                for number in range(first, round(seconds * rate_hz)):
                    time.sleep(max(began[0] + number / rate_hz - time.monotonic(), 0.0))
                    t_s = number / rate_hz
                    if any(a <= t_s < b for a, b in spans):
                        return
                    data = pictures[number % len(pictures)]
                    self.wfile.write(b"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: %d\r\n\r\n" % len(data))
                    self.wfile.write(data + b"\r\n")
                    sent(number)

    server = ThreadingHTTPServer(("127.0.0.1", port), Stream)
    server.daemon_threads = True
    threading.Thread(target=server.serve_forever, daemon=True).start()
    return server


def main() -> None:
    """Send one film."""
    kind, film, port, seconds, log_path = (
        sys.argv[1],
        Path(sys.argv[2]),
        int(sys.argv[3]),
        float(sys.argv[4]),
        sys.argv[5],
    )
    with open(log_path, "w", encoding="utf-8", buffering=1) as log:
        if kind == "udp":
            address = f"udp://127.0.0.1:{port}?pkt_size=1316"
            send_packets(film, address, "mpegts", {"flush_packets": "1"}, seconds, log)
        elif kind == "rtsp":
            options = {"rtsp_transport": "udp", "flush_packets": "1"}  # the server of Debian's knows no other
            send_packets(film, f"rtsp://127.0.0.1:{port}/tow", "rtsp", options, seconds, log)
        else:
            pictures, rate = jpegs(film)
            print("ready", flush=True)
            serve_jpegs(pictures, rate, port, seconds, lambda n: log.write(f"{n} {time.monotonic():.6f}\n") and None)
            time.sleep(seconds + 20)


if __name__ == "__main__":
    main()

"""PNG pictures, and the tensor files of truth volumes."""

import json
import struct
import zlib

import numpy as np


def write_png(path, pixels):
    """8-bit pixels `[height, width]` (grey) or `[height, width, 4]` (RGBA)."""
    height, width = pixels.shape[:2]
    rows = np.ascontiguousarray(pixels, np.uint8).reshape(height, -1)
    # each row after the byte of its filter: none
    data = zlib.compress(np.pad(rows, ((0, 0), (1, 0))).tobytes(), 6)
    head = struct.pack(">IIBBBBB", width, height, 8, 6 if pixels.ndim == 3 else 0, 0, 0, 0)

    def chunk(kind, content):
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

    path.write_bytes(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", data) + chunk(b"IEND", b""))


def straight(picture):
    """The bytes of a picture with straight alpha."""
    alpha = picture[..., 3:]
    colour = np.where(alpha > 0, picture[..., :3] / np.maximum(alpha, 1e-6), 0)
    return (np.clip(np.concatenate([colour, alpha], axis=-1), 0, 1) * 255 + 0.5).astype(np.uint8)


def write_truth_volume(path, time, side, ids, opacity):
    """`ids` and `opacity` in 16 bits, in a safetensors file whose header has time and geometry."""
    count = ids.shape[0]
    place = {"format": 1, "time": time, "spacing": [side / (count - 1)] * 3, "origin": [-side / 2] * 3}
    tensors = {"ids": ids.astype("<u2"), "opacity": np.round(np.clip(opacity, 0, 1) * 65535).astype("<u2")}
    header, body = {"__metadata__": {"volseggs.truth-volume": json.dumps(place)}}, b""
    for name, tensor in tensors.items():
        data = tensor.tobytes()
        header[name] = {"dtype": "U16", "shape": tensor.shape, "data_offsets": [len(body), len(body) + len(data)]}
        body += data
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 8)
    path.write_bytes(struct.pack("<Q", len(text)) + text + body)

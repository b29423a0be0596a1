"""usage: column.py FILE.rows COLUMN"""
import json, struct, sys, zlib

def column(path, name):
    """A tuple of `width` values for each row."""
    data, rows_read = open(path, "rb").read(), []
    at = data.index(b"\n") + 1
    columns = json.loads(data[:at])["columns"]
    k = [c["name"] for c in columns].index(name)
    width, kind = columns[k]["width"], columns[k]["kind"]
    code = {"f64": "d", "f32": "f", "u64": "Q", "u32": "I", "u8": "B"}[kind]
    size = struct.calcsize("<" + code)
    while data[at:at + 8] == b"wingdrow":
        rows, length = struct.unpack_from("<II", data, at + 8)
        parts = struct.unpack_from(f"<{len(columns)}I", data, at + 48)
        start = at + 48 + 4 * len(columns) + sum(parts[:k])
        part, values = data[start:start + parts[k]], rows * width
        if len(part) < values * size:
            sorted_bytes = zlib.decompress(part)
            part = bytes(sorted_bytes[b * values + i] for i in range(values) for b in range(size))
        numbers = struct.unpack(f"<{values}{code}", part)
        rows_read += [numbers[i:i + width] for i in range(0, values, width)]
        at += 48 + length
    return rows_read

for row in column(sys.argv[1], sys.argv[2]):
    print(*row)

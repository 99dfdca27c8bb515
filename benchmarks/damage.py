"""Random damage to bytes, safetensors headers, tensors, JSON and YAML."""

from __future__ import annotations

import copy
import gzip
import io
import json
import pickle
import random
import struct
import zipfile
from collections.abc import Callable
from typing import Any

import numpy as np
from safetensors.numpy import load, save

DEEP = "@deep@"  # placeholder for a hundred thousand nested brackets in JSON
_VALUES: list[Any] = [
    None,
    True,
    False,
    -1,
    0,
    1,
    2.5,
    10**9,
    2**63,
    10**400,
    -(10**400),
    1e308,
    float("nan"),
    float("inf"),
    "",
    "abc",
    "10",
    "nan",
    "../../etc/passwd",
    "os.system",
    "${nowhere}",
    "${oc.env:HOME}",
    "???",
    "a" * 10_000,
    "\ud83d\ude00",
    [],
    [1, 2],
    [[]],
    {},
    {"a": 1},
    DEEP,
]
_PNG = bytes.fromhex("89504e470d0a1a0a0000000d4948445200000001000000010802000000907753de")


def damaged_bytes(r: random.Random, valid: bytes) -> bytes:
    """Return a file that is truncated, has flipped bits or is of another type."""
    return r.choice([_truncated, _truncated, _flipped, _flipped, _foreign])(r, valid)


def _truncated(r: random.Random, valid: bytes) -> bytes:
    header = 8 + struct.unpack("<Q", valid[:8])[0] if len(valid) > 8 else 0
    ends = [r.randint(0, 9), header, header + 1, len(valid) - 1, r.randrange(len(valid))]
    return valid[: max(0, min(r.choice([*ends, r.randint(0, max(header, 1))]), len(valid) - 1))]


def _flipped(r: random.Random, valid: bytes) -> bytes:
    damaged = bytearray(valid)
    prefix = r.choice([8, 100, len(valid)])  # more often near the beginning
    for _ in range(r.randint(1, 8)):
        damaged[r.randrange(min(prefix, len(valid)))] ^= 1 << r.randrange(8)
    return bytes(damaged)


def _foreign(r: random.Random, valid: bytes) -> bytes:
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w") as file:
        file.writestr("data.pkl", pickle.dumps({"weights": [1.0]}))
    return r.choice(
        [
            b"",
            b"\n",
            pickle.dumps({"weights": [1.0]}),
            archive.getvalue(),
            _PNG,
            b"{}",
            b"[]",
            gzip.compress(valid[:1000]),
            r.randbytes(r.randint(1, 5000)),
            b"hello\n" * 100,
            valid + valid,
            valid[::-1],
            b"\x00" * 1000,
        ]
    )


def hostile_header(r: random.Random, valid: bytes) -> bytes:
    """Return a safetensors file with an inconsistent header."""
    size = struct.unpack("<Q", valid[:8])[0]
    header, data = json.loads(valid[8 : 8 + size]), valid[8 + size :]
    if r.random() < 0.25:
        sizes = [0, 1, size - 1, size + 1, 10**8, 10**9, 2**32, 2**40, 2**63, 2**64 - 1]
        return struct.pack("<Q", r.choice(sizes)) + valid[8:]
    name = r.choice([key for key in header if key != "__metadata__"])
    tensor = header[name]
    begin, end = tensor["data_offsets"]
    entries = [
        ("data_offsets", [-1, end]),
        ("data_offsets", [begin, end + 4]),
        ("data_offsets", [end, begin]),
        ("data_offsets", [0, 4]),
        ("data_offsets", [begin, 2**63]),
        ("data_offsets", [10**12, 10**12 + end - begin]),
        ("data_offsets", []),
        ("data_offsets", [0.5, 1.5]),
        ("shape", [2**31, 2**31]),
        ("shape", [10**9]),
        ("shape", [-1]),
        ("shape", [2**63, 2]),
        ("shape", [1.5]),
        ("shape", []),
        ("shape", [0]),
        ("shape", [1] * 500),
        ("shape", None),
        ("shape", tensor["shape"][::-1]),
        ("shape", [*tensor["shape"], 1]),
        ("dtype", "F32x"),
        ("dtype", "I32"),
        ("dtype", "U32"),
        ("dtype", "F64"),
        ("dtype", "F16"),
        ("dtype", "BF16"),
        ("dtype", "F8_E4M3"),
        ("dtype", "BOOL"),
        ("dtype", None),
        ("dtype", 7),
        ("dtype", "\u0000"),
    ]
    choice = r.randrange(8)
    if choice < 4:
        key, value = r.choice(entries)
        tensor[key] = value
    elif choice == 4:
        header[r.choice(["../x", "", "weights", "optimisers/adam/0/exp_avg"])] = header.pop(name)
    elif choice == 5:
        del tensor[r.choice(list(tensor))]
    elif choice == 6:
        header["__metadata__"] = r.choice([None, 1, [], {"format": 1}, {"progress": "[" * 10**5}])
    text = json.dumps(header)
    if choice == 7:
        text = r.choice(
            [
                text.replace(
                    "{", '{"' + name + '": ' + json.dumps(tensor) + ", ", 1
                ),  # duplicate key
                "[" * 100_000,
                text[:-1] + ',"a":' * 1000,
                text.replace('"', "'"),
                "null",
                "[]",
                "7",
            ]
        )
    return struct.pack("<Q", len(text.encode())) + text.encode() + data


def invalid_tensors(r: random.Random, valid: bytes) -> bytes:
    """Return a well-formed safetensors file with NaN, infinity or unexpected tensors."""
    tensors = {name: value.copy() for name, value in load(valid).items()}
    name = r.choice([key for key, value in tensors.items() if value.size])
    value = tensors[name]
    not_finite = r.choice([np.nan, np.inf, -np.inf])
    choice = r.randrange(6)
    if choice < 3 and value.dtype.kind == "f":
        value[tuple(r.randrange(n) for n in value.shape)] = not_finite
    elif choice == 3:
        tensors[name] = np.full_like(value, 1e300, dtype=np.float64)
    elif choice == 4:
        tensors[name] = np.zeros((*value.shape, 2), value.dtype)
    else:
        tensors["stranger"] = tensors.pop(name)
    size = struct.unpack("<Q", valid[:8])[0]
    return save(tensors, json.loads(valid[8 : 8 + size]).get("__metadata__"))


def damaged_json(r: random.Random, valid: Any) -> bytes:
    """Return JSON with missing, unexpected or additional entries, or no valid JSON at all."""
    tree = copy.deepcopy(valid)
    if r.random() < 0.15:
        whole = json.dumps(tree).encode()
        return r.choice(
            [
                _truncated(r, whole),
                _flipped(r, whole),
                _foreign(r, whole),
                b"\xff\xfe" + whole,
                b"\xef\xbb\xbf" + whole,
                b"[" * 100_000,
                b'{"a":' * 100_000,
                b"9" * 5000,
                b"null",
                b"3",
            ]
        )
    for _ in range(r.choice([1, 1, 1, 2])):
        container, key = r.choice(list(_places(tree)))
        if r.random() < 0.15:
            del container[key]
        elif r.random() < 0.1 and isinstance(container, dict):
            value = r.choice(_VALUES)
            container[r.choice(["stranger", "", "__class__", "format ", "name"])] = value
        else:
            container[key] = copy.deepcopy(r.choice(_VALUES))
        if not tree:
            break
    text = json.dumps(tree).replace(json.dumps(DEEP), "[" * 100_000 + "]" * 100_000)
    return text.encode()


def _places(tree: Any) -> list[tuple[Any, Any]]:
    """Return the container and key of every entry, those that hold containers several times."""
    places: list[tuple[Any, Any]] = []
    keys = list(tree) if isinstance(tree, dict) else range(len(tree))
    for key in keys:
        places += [(tree, key)] * (3 if isinstance(tree[key], dict | list) else 1)
        if isinstance(tree[key], dict | list) and tree[key]:
            places += _places(tree[key])
    return places


def damaged_yaml(r: random.Random, valid: str) -> bytes:
    """Return YAML with unexpected values, or no valid YAML at all."""
    key = r.choice([line.partition(":")[0] for line in valid.splitlines() if ":" in line])
    alias_bomb = "a: &a [x, x, x, x, x, x, x, x, x, x]\n" + "".join(
        f"{b}: &{b} [{', '.join(['*' + a] * 10)}]\n"
        for a, b in zip("abcdefgh", "bcdefghi", strict=True)
    )
    documents: list[Callable[[], str | bytes]] = [
        lambda: "",
        lambda: "\t- a",
        lambda: "- a\n- b",
        lambda: "7",
        lambda: "null",
        lambda: valid.replace(": ", ":\t\t- ", 1),
        lambda: valid + "\n  bad indent: [",
        lambda: "!!python/object/apply:os.system ['true']",
        lambda: alias_bomb + valid,
        lambda: "[" * 3000,
        lambda: "{a: " * 3000,
        lambda: f"{valid}\n{valid}",
        lambda: "&a [*a]",
        lambda: "\x07",
        lambda: b"\xff\xfe\x00",
        lambda: "%YAML 9.9\n---\n" + valid,
        lambda: "--- 1\n--- 2\n",
        lambda: "defaults: 3\n" + valid,
        lambda: "defaults: [nowhere]\n" + valid,
        lambda: "defaults: [{agent: ../../x}]\n" + valid,
        lambda: "? [a, b]\n: 3\n" + valid,
        lambda: "1: 2\n" + valid,
        lambda: "2020-01-01: 1\n" + valid,
        lambda: f"<<: {{{key}: 1}}\n" + valid,
        lambda: _truncated(r, valid.encode()),
        lambda: _flipped(r, valid.encode()),
        lambda: _foreign(r, valid.encode()),
    ]
    if r.random() < 0.5:
        text = r.choice(documents)()
        return text if isinstance(text, bytes) else text.encode()
    value = r.choice(
        [
            "10**9",
            "1000000000",
            "1e400",
            "-1",
            ".nan",
            ".inf",
            "''",
            "abc",
            "[1, 2]",
            "{a: 1}",
            "null",
            "~",
            "yes",
            "!!binary aGVsbG8=",
            "!!float x",
            "!!set {1}",
            "2020-01-01",
            "0x10",
            "1_0",
            "*nobody",
            "${nowhere}",
            "${",
            "???",
            "'" + "a" * 10_000 + "'",
            "9" * 5000,
            "|",
        ]
    )
    return (
        f"{valid}\n{key}: {value}\n".encode()
        if r.random() < 0.3
        else "\n".join(
            f"{key}: {value}" if line.startswith(f"{key}:") else line for line in valid.splitlines()
        ).encode()
    )

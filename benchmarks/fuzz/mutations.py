"""Mutations: what becomes of good files. Each takes a random generator, the files and the name of one, and changes it.

Those of ``OWN`` make files that are whole in themselves, seals and checksums included: what they change is no damage
but another truth, and need not be noticed; they bring nonsense behind the seals, to the readers proper.
"""

from __future__ import annotations

import hashlib
import json
import random
import sqlite3
import struct
import tempfile
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import yaml

from benchmarks.fuzz import crafted, records
from benchmarks.fuzz.subjects import Files
from hybrid_sysid_ros.bags.mcap import CHUNK, MESSAGE
from hybrid_sysid_ros.models.storage import ARRAYS, _seal

Mutation = Callable[[random.Random, Files, str], Files]

_Loader: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_Dumper: Any = getattr(yaml, "CSafeDumper", yaml.SafeDumper)
DOUBLES = (float("nan"), float("inf"), 1e300, -1e300, 0.0, 1e-320)
NUMBERS = (0, 1, 0x7F, 0xFF, 0xFFFF, 0x7FFFFFFF, 0xFFFFFFFF, 1 << 40, (1 << 63) - 1, 1 << 63, (1 << 64) - 1)


# any file


def bit(rng: random.Random, files: Files, name: str) -> Files:
    """Bits flipped."""
    content = bytearray(files[name])
    for _ in range(rng.choice((1, 1, 1, 2, 8))):
        content[rng.randrange(len(content))] ^= 1 << rng.randrange(8)
    return {**files, name: bytes(content)}


def byte(rng: random.Random, files: Files, name: str) -> Files:
    """Bytes at random, or zeros."""
    content = bytearray(files[name])
    place, count = rng.randrange(len(content)), rng.choice((1, 1, 2, 4, 16, 256))
    content[place : place + count] = rng.randbytes(count) if rng.random() < 0.7 else bytes(count)
    return {**files, name: bytes(content)}


def cut(rng: random.Random, files: Files, name: str) -> Files:
    """The file ends early."""
    return {**files, name: files[name][: rng.randrange(len(files[name]))]}


def splice(rng: random.Random, files: Files, name: str) -> Files:
    """A part of it, or of another file, in another place of it: left out, twice, or over what is there."""
    content, other = files[name], files[rng.choice(list(files))]
    start, place = rng.randrange(len(other)), rng.randrange(len(content))
    part = other[start : start + int(len(other) * rng.random() ** 4)]
    over = rng.choice((0, len(part)))
    if rng.random() < 0.3:
        part = b""
    return {**files, name: content[:place] + part + content[place + over :]}


def length(rng: random.Random, files: Files, name: str) -> Files:
    """A number of 2, 4 or 8 bytes is another, wherever it is."""
    content, size = bytearray(files[name]), rng.choice((2, 4, 8))
    place = rng.randrange(max(1, len(content) - size))
    old = int.from_bytes(content[place : place + size], "little")
    new = rng.choice((*NUMBERS, old + 1, old - 1, old * 2, len(content))) & ((1 << 8 * size) - 1)
    content[place : place + size] = new.to_bytes(size, "little")
    return {**files, name: bytes(content)}


# YAML


def value(rng: random.Random, files: Files, name: str) -> Files:
    """A value, key or part of a YAML file is another, and the seal fits."""
    return resealed(files, name, _other(rng, _loaded(files[name])))


def text(rng: random.Random, files: Files, name: str) -> Files:
    """Crafted YAML in place of a value, or of all of it."""
    lines = files[name].decode().splitlines(keepends=True)
    if rng.random() < 0.2:
        return {**files, name: crafted.document(rng)}
    at = rng.randrange(len(lines))
    key, colon, _ = lines[at].partition(":")
    lines[at] = f"{key}{colon} {crafted.snippet(rng)}\n" if colon else f"{crafted.snippet(rng)}\n"
    return {**files, name: "".join(lines).encode("utf-8", "surrogatepass")}


def _loaded(content: bytes) -> Any:
    return yaml.load(content, _Loader)


def _other(rng: random.Random, content: Any) -> Any:
    if not isinstance(content, dict | list) or not content or rng.random() < 0.02:
        return crafted.value(rng, content)
    keys = list(content) if isinstance(content, dict) else range(len(content))
    key, fate = rng.choice(keys), rng.random()
    copy: Any = dict(content) if isinstance(content, dict) else list(content)
    if fate < 0.1:
        del copy[key]
    elif fate < 0.15 and isinstance(copy, dict):
        copy[rng.choice((f"{key}x", 1, None, "", 1.5, True, "a\nb"))] = copy.pop(key)
    elif fate < 0.2 and isinstance(copy, list):
        copy += [copy[key]] * rng.choice((1, 2, 1000))
    else:
        copy[key] = _other(rng, content[key])
    return copy


def resealed(files: Files, name: str, content: Any) -> Files:
    """The files with this content in one, and seals that fit."""
    if isinstance(content, dict) and "seal" in content:
        body = {key: item for key, item in content.items() if key != "seal"}
        with suppress(TypeError, ValueError):  # what no seal can be made of
            content = {**body, "seal": _seal(body)}
    made = yaml.dump(content, Dumper=_Dumper, sort_keys=False, allow_unicode=True)
    found = {**files, name: made.encode("utf-8", "replace")}
    certificate = name.replace("policy.yaml", "certificate.yaml")
    if certificate != name and certificate in files and isinstance(content, dict):
        return resealed(found, certificate, {**_loaded(files[certificate]), "policy": content.get("seal")})
    return found


def arrays(rng: random.Random, files: Files, name: str) -> Files:
    """The header or the numbers of a file of arrays are others, and seals fit."""
    content = files[name]
    (size,) = struct.unpack_from("<Q", content)
    header, numbers = json.loads(content[8 : 8 + size]), bytearray(content[8 + size :])
    if rng.random() < 0.3:
        place = rng.randrange(0, len(numbers), 8)
        numbers[place : place + 8] = struct.pack("<d", rng.choice(DOUBLES))
        text = json.dumps(header)
    elif rng.random() < 0.1:
        text = rng.choice(("{" * 5000, "[" * 200 + "]" * 200, "null", "{}", '{"a":1}', " " * 100_000, '{"a":{}}'))
    else:
        text = json.dumps(_other(rng, header))
    made = struct.pack("<Q", len(text.encode())) + text.encode() + bytes(numbers)
    folder = name.rpartition("/")[0]
    sheet = next(key for key in (f"{folder}/model.yaml", f"{folder}/policy.yaml") if key in files)
    reported = _loaded(files[sheet])
    reported["arrays"] = {"file": ARRAYS, "sha256": hashlib.sha256(made).hexdigest()}
    return resealed({**files, name: made}, sheet, reported)


# MCAP


def record(rng: random.Random, files: Files, name: str) -> Files:
    """A record is lost, doubled, moved or changed in a field; checksums are those of before."""
    found = records.split(files[name])
    at = rng.randrange(len(found))
    code, content = found[at]
    fate = rng.random()
    if fate < 0.2:
        del found[at]
    elif fate < 0.3:
        found.insert(rng.randrange(len(found)), found[at])
    elif fate < 0.4:
        found[at] = (rng.choice((*range(17), 0x80)), content)
    elif content:
        found[at] = (code, _with_number(rng, content, 60))
    return {**files, name: records.file_of(found)}


def inner(rng: random.Random, files: Files, name: str) -> Files:
    """The records of a chunk are others, with checksums, sizes and counts that fit."""
    found = records.split(files[name])
    chunks = [at for at, (code, _) in enumerate(found) if code == CHUNK]
    if not chunks:
        return _with(files, name, records.file_of(_mutated(rng, found)))
    at = rng.choice(chunks)
    compression, inside = records.inside(found[at][1])
    inside = _mutated(rng, inside)
    found[at] = (CHUNK, records.chunk_of(compression, records.joined(inside)))
    with suppress(struct.error):
        found = records.counted(found) if rng.random() < 0.8 else found
    return _with(files, name, records.file_of(found))


def bomb(rng: random.Random, files: Files, name: str) -> Files:
    """A small file that asks for much: memory, depth or time."""
    return _with(files, name, crafted.mcap(rng, files[name]))


def _mutated(rng: random.Random, found: list[records.Record]) -> list[records.Record]:
    found = list(found)
    for _ in range(rng.choice((1, 1, 2, 5))):
        at = rng.randrange(len(found))
        code, content = found[at]
        fate = rng.random()
        if fate < 0.1:
            del found[at]
        elif fate < 0.2:
            found.insert(rng.randrange(len(found)), found[at])
        elif fate < 0.3 and code == MESSAGE:
            found[at] = (code, content[:22] + crafted.cdr(rng))
        elif content and (fate < 0.8 or code == MESSAGE):
            found[at] = (code, _with_number(rng, content, 120))
        else:
            changed = bit(rng, {"": content or b"x"}, "")[""]
            found[at] = (code, changed)
        if not found:
            found = [(code, content)]
    return found


def _with_number(rng: random.Random, content: bytes, reach: int) -> bytes:
    part = {"": content[:reach]}
    return (length if rng.random() < 0.6 else byte)(rng, part, "")[""] + content[reach:]


def _with(files: Files, name: str, content: bytes) -> Files:
    """A bag with another MCAP file, and without the metadata.yaml that would give it away."""
    return {**{key: item for key, item in files.items() if not key.endswith("metadata.yaml")}, name: content}


# SQLite


def table(rng: random.Random, files: Files, name: str) -> Files:
    """The tables of a SQLite file are others."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "base"
        path.write_bytes(files[name])
        base = sqlite3.connect(path)
        with suppress(sqlite3.Error):  # NOT NULL, in some
            base.executescript(crafted.sql(rng))
            base.commit()
        base.close()
        return {**files, name: path.read_bytes()}


ANY = (bit, byte, cut, splice, length)
OWN = (value, text, arrays, inner, bomb, table)
"""What they make is whole in itself."""


def of(name: str) -> tuple[Mutation, ...]:
    """The mutations that make sense for a file."""
    ending = name.rpartition(".")[2]
    return {
        "mcap": (*ANY, record, record, inner, inner, bomb),
        "yaml": (*ANY[:4], value, value, value, text, text),
        "safetensors": (*ANY, arrays, arrays),
        "db3": (*ANY, table),
    }.get(ending, ANY)

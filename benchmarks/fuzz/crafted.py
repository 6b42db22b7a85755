"""Crafted: what a person who knows the formats would write to bring a reader down."""

from __future__ import annotations

import random
import struct
import sys
from functools import lru_cache
from typing import Any

import lz4.frame  # type: ignore[import-untyped]

from benchmarks.fuzz import records
from hybrid_sysid_ros.bags.mcap import CHUNK, DATA_END, MESSAGE

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

_LINE = "=" * 80 + "\n"
_TEXTS = r"""
2024-13-45 | 2024-01-01 | 2024-01-01 25:61:61 | !!int abc | !!float abc | !!bool abc | !!int '' | !!null x
!!binary '%%%' | !!timestamp abc | !!set {a, b} | !!omap [a] | !!pairs [a] | !!python/name:os.system x
!!python/object/apply:os.getcwd [] | !unknown {a: 1} | {[1]: 2} | {{a: 1}: 2} | ? [a] | *nothing | &a [*a]
&a {b: *a} | {<<: {a: 1}} | {<<: 5} | {<<: [1, 2]} | &a {<<: *a} | .nan | .inf | -.inf | 1e999 | -1e308 | 1e-320
1:1:1:1 | 0b1 | 0o17 | 017 | "\0" | "\x85\u2028" | "a\nb" | 'a | [ | { | - - - - | %YAML 9.9 | ~ | '' | yes | {} | []
"""
SNIPPETS = (
    *(text.strip() for line in _TEXTS.strip().splitlines() for text in line.split(" | ")),
    *("0x" + "f" * 50, "0x" + "f" * 5000, "1" * 400, "1" * 5000, "1:" * 50 + "1", "|\n  a\n b", "---\na: 1\n---\nb"),
    *("\x00", "\x07", "\ud800", "\ufeff", "\u202eabc", "{" * 200, "[" * 5000, "{a: " * 5000, "- " * 5000, "? " * 3000),
    *("[" + "1, " * 5000 + "1]", '"' + "a" * 100_000 + '"', "[" + "[" * 30 + "]" * 30 + "]"),
    "[&a " + ", &".join(f"{chr(98 + k)} [{', '.join([f'*{chr(97 + k)}'] * 10)}]" for k in range(12)) + "]",
)
VALUES: tuple[Any, ...] = (
    *(None, True, False, 0, -1, 1, 2, 3, 7, 100, 10**6, 10**9, 2**31, 2**63, -(2**63), 2**64 - 1, 10**30, 10**400),
    *(0.0, -0.0, 0.5, -1.5, 1e-320, 1e-9, 1e9, 1e300, 1e308, float("nan"), float("inf"), -float("inf")),
    *("", "a", "../../etc/passwd", "/", "a\nb", "\x00", "x" * 5000, "1", "nan", "{}", "\u202e", "0" * 50),
    *([], {}, [[]], [1.0, 2.0], [None], {"a": 1}, ["a"] * 100, [0.0] * 5000, [[[[[[1]]]]]], {"": {}}, {"1": [1, "a"]}),
)


def snippet(rng: random.Random) -> str:
    """Text in the place of a value of YAML."""
    return rng.choice(SNIPPETS)


def value(rng: random.Random, old: Any) -> Any:
    """A value in place of another, often of its kind."""
    if isinstance(old, bool) or old is None or rng.random() < 0.5:
        return rng.choice(VALUES)
    if isinstance(old, int | float):
        return rng.choice(
            (-old, old * 2, old + 1, old * 1e6, old / 1e6, float(old), str(old), [old], int(min(max(old, -1e9), 1e9)))
        )
    if isinstance(old, str):
        return rng.choice((old.upper(), old + old, old[:-1], f"{old}[0]", f"/{old}", old.replace("0", "9")))
    return [old] if rng.random() < 0.5 else {"a": old}


def document(rng: random.Random) -> bytes:
    """A YAML file."""
    chosen = rng.randrange(10)
    if chosen == 0:
        return "a: 1".encode(rng.choice(("utf-16", "utf-32", "utf-16-le"))) + "é".encode("latin-1")
    if chosen == 1:
        return b"\xff\xfe" + rng.randbytes(1000)
    if chosen == 2:
        depth, width = rng.choice((9, 30, 200)), rng.choice((2, 10, 100))
        levels = [f"k{k}: &k{k} [{', '.join([f'*k{k - 1}'] * width)}]\n" for k in range(1, depth)]
        return ("k0: &k0 [a, b]\n" + "".join(levels)).encode()
    if chosen == 3:
        levels = [f"k{k}: &k{k}\n  <<: [{', '.join([f'*k{k - 1}'] * 20)}]\n  x{k}: 1\n" for k in range(1, 12)]
        return ("k0: &k0 {a: 1}\n" + "".join(levels)).encode()
    if chosen == 4:
        return (rng.choice("[{") * rng.choice((40, 1000, 5000, 100_000, 900_000))).encode()
    if chosen == 5:
        return "".join(f"k{k}: {k}\n" for k in range(rng.choice((1000, 30_000, 80_000)))).encode()
    if chosen == 6:
        return b"a: " + b"1" * rng.choice((1000, 1_000_000, 2_000_000))
    if chosen == 7:
        return b"a" * rng.choice((1000, 3_000_000)) + b": 1"
    if chosen == 8:
        return "".join(f"{' ' * k}a:\n" for k in range(rng.choice((20, 100, 1000)))).encode()
    return rng.choice((b"", b"\n", b"5", b"[]", b"- a", b"null", b"a", b"{}", b"\x00" * 100, b"# nothing", b"---\n"))


def cdr(rng: random.Random) -> bytes:
    """A message's bytes."""
    head = b"\x00\x01\x00\x00" + struct.pack("<iI", 1_700_000_000, rng.randrange(10**9))
    frame = struct.pack("<I", 1) + bytes(4)
    chosen = rng.randrange(5)
    if chosen == 0:
        return rng.randbytes(rng.randrange(64))
    if chosen == 1:
        return head + struct.pack("<I", rng.choice((0, 1, 0xFFFFFFFF, 1 << 31, 1 << 20))) + bytes(rng.randrange(100))
    if chosen == 2:
        return head + frame + struct.pack("<I", rng.choice((1 << 16, 1 << 20))) + bytes(1000)
    if chosen == 3:  # a list of many empty texts
        count = rng.choice((*[1000, 10_000, 100_000] * 4, 1_000_001))
        return head + frame + struct.pack("<I", count) + bytes(4 * count)
    return head + bytes(rng.choice((10, 1000, 5_000_000, 20_000_000)))


DEFINITIONS = (
    "a/A a\n" + "=" * 80 + "\nMSG: a/A\na/A a\n",
    "a/A[] a\n" + "=" * 80 + "\nMSG: a/A\na/A[] a\n",
    "a/A[4000000000] a\n" + "=" * 80 + "\nMSG: a/A\n",
    "float64[4000000000] position\nfloat64[18446744073709551616] effort\n",
    "string[1000000000] name\n",
    "a/A0 a\n"
    + "".join(f"{_LINE}MSG: a/A{k}\na/A{k + 1} a\na/A{k + 1} b\n" for k in range(60))
    + f"{_LINE}MSG: a/A60\n",
    "a/A0 a\n" + "".join(f"{_LINE}MSG: a/A{k}\na/A{k + 1}[1000] a\n" for k in range(9)) + f"{_LINE}MSG: a/A9\n",
    "float64 a\n" * 5000,
    "float64 a\n" * 50_000,
    "float64 " + "a" * 200_000 + "\n",
    "float64 a " + "1" * 5000 + "\n",
    "x" * 1000,
    "=" * 80 + "\n",
    "string<=99999999999 name\nwstring w\n",
    "float64[<=3] position\nfloat64 __class__\n",
)
IDL = (
    "module a { module msg { const long X = ((((1)))); struct S { long a; }; }; };",
    "module a { module msg { struct JointState { sequence<double> position; }; }; };",
    "module a { " * 3000,
    "struct S { " + "sequence<" * 500 + "long" + ">" * 500 + " a; };",
    "@verbatim(language='comment', text='" + "x" * 100_000 + "')",
    "enum E { " + ", ".join(f"A{k}" for k in range(3000)) + " };",
)


@lru_cache(maxsize=8)
def _zeros(compression: str, size: int) -> bytes:
    """So many zeros packed."""
    part, count = bytes(1 << 24), size >> 24
    if compression == "zstd":
        packer = zstd.ZstdCompressor()
        return b"".join([packer.compress(part) for _ in range(count)] + [packer.flush()])
    with lz4.frame.LZ4FrameCompressor() as packer:
        return packer.begin() + b"".join([packer.compress(part) for _ in range(count)] + [packer.flush()])


def mcap(rng: random.Random, content: bytes) -> bytes:
    """An MCAP file of the records of a good one, and something that asks for much."""
    found = records.split(content)
    chunks = [at for at, (code, _) in enumerate(found) if code == CHUNK]
    compression = rng.choice(("zstd", "zstd", "lz4"))
    chosen = rng.randrange(9)
    inner = records.inside(found[chunks[0]][1])[1] if chunks else [one for one in found if one[0] in (3, 4, 5)]
    at = 1 if not chunks else rng.choice(chunks)
    if chosen == 0:
        size = rng.choice((1 << 24, 1 << 28, 1 << 30))
        said = rng.choice((size, 0, 1000, 1 << 40, (1 << 64) - 1, 1 << 26, (1 << 26) - 1))
        found.insert(at, (CHUNK, records.chunk_around(compression, _zeros(compression, size), size=said)))
        return records.file_of(found)
    if chosen in (1, 2):
        schema = next(one for one in inner if one[0] == 3)
        number, size = struct.unpack_from("<HI", schema[1])
        name = schema[1][6 : 6 + size].decode()
        idl = rng.random() < 0.4
        made = records.schema(number, name, rng.choice(IDL if idl else DEFINITIONS), "ros2idl" if idl else "ros2msg")
        inner = [made if one == schema else one for one in inner]
    elif chosen == 3:
        count = rng.choice((1000, 20_000, 60_000))
        topic = rng.choice(("/arm/joint_states", "/t{}"))
        inner += [records.channel(100 + k, 1, topic.format(k)) for k in range(count)]
    elif chosen == 4:
        inner += [records.schema(100 + k, f"a/msg/A{k}", "float64 a\n" * 20) for k in range(rng.choice((1000, 20_000)))]
    elif chosen == 5:
        large = next(one for one in inner if one[0] == MESSAGE)
        filler = bytes(rng.choice((1 << 20, 1 << 22, 1 << 23, 30 << 20)))
        inner += [(MESSAGE, large[1] + filler)] * rng.choice((1, 16))
    elif chosen == 6:
        large = next(one for one in inner if one[0] == MESSAGE)
        inner += [(MESSAGE, large[1][:22] + cdr(rng)) for _ in range(rng.choice((1, 100)))]
    elif chosen == 7:
        large = next(one for one in inner if one[0] == MESSAGE)
        inner += [(MESSAGE, large[1][:22] + rng.choice((b"", bytes(4), large[1][22:])))] * rng.choice((10_000, 400_000))
    else:
        tiny = (CHUNK, records.chunk_of("", b""))
        rest = [(CHUNK, records.chunk_of("zstd", records.joined(inner))), *[tiny] * 20_000]
        return records.file_of([found[0], *rest, (DATA_END, bytes(4))])
    made_of = [found[0], (CHUNK, records.chunk_of(compression, records.joined(inner)))]
    return records.file_of(records.counted(made_of) if rng.random() < 0.5 else [*made_of, (DATA_END, bytes(4))])


SQL = (
    "DROP TABLE messages",
    "DROP TABLE topics",
    "DELETE FROM messages WHERE rowid % 2",
    "DELETE FROM topics",
    "UPDATE messages SET data = x''",
    "UPDATE messages SET data = 'text'",
    "UPDATE messages SET data = 5 WHERE rowid = 7",
    "UPDATE messages SET timestamp = 'then'",
    "UPDATE messages SET timestamp = 1e300",
    "UPDATE messages SET timestamp = -9223372036854775808",
    "UPDATE messages SET topic_id = 99 WHERE rowid > 5",
    "UPDATE messages SET data = zeroblob(100000000) WHERE rowid = 3",
    "UPDATE topics SET type = ''",
    "UPDATE topics SET name = x'ff', type = 7",
    "UPDATE message_definitions SET encoded_message_definition = 'a/A a'",
    "UPDATE message_definitions SET encoding = 'none'",
    "UPDATE message_definitions SET encoded_message_definition = replace(hex(zeroblob(1000000)), '0', 'float64 a\n')",
    "ALTER TABLE messages RENAME TO m;"
    "CREATE VIEW messages AS SELECT id, topic_id, timestamp, zeroblob(999999999) AS data FROM m",
    "ALTER TABLE messages RENAME COLUMN data TO d;"
    "ALTER TABLE messages ADD COLUMN data BLOB GENERATED ALWAYS AS (zeroblob(900000000)) VIRTUAL",
    "ALTER TABLE messages RENAME COLUMN data TO d;"
    "ALTER TABLE messages ADD COLUMN data BLOB GENERATED ALWAYS AS (hex(zeroblob(400000000))) VIRTUAL",
)


def sql(rng: random.Random) -> str:
    """Statements that spoil a bag of SQLite."""
    return rng.choice(SQL)

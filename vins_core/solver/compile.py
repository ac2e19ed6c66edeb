"""The compiled kernels, made once per machine and kept in the user's cache.

    <cache>/vinspect/compiled/<key>/   kernels.c   kernels.so   about.json

The key is a hash of the C source, the compiler and its version, the flags and the processor.  A folder is published
by renaming it, so that a reader sees all of it or nothing, and of two processes that build the same the first wins.
Nothing is published before it has given the bits of NumPy (compiled_rows.check); what does not compile or is not
equal leaves its reason instead, and is not tried again.
"""

from __future__ import annotations

import hashlib
import os
import platform
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import msgspec

from ..errors import BackendError
from .compiled_rows import Library, check, source

FLAGS = ("-std=c11", "-O3", "-march=native", "-ffp-contract=off", "-fno-math-errno", "-shared", "-fPIC")
"""No operation may be fused with another (contraction) or moved: see kernel.c."""
TIMEOUT_S = 300.0
C_FILE, LIBRARY, ABOUT = "kernels.c", "kernels.so", "about.json"

_background: subprocess.Popen[bytes] | None = None


@dataclass(frozen=True)
class Compiler:
    command: tuple[str, ...]
    version: str  # its own words


@dataclass(frozen=True)
class Kernels:
    """An entry of the cache: a library, or why there is none."""

    key: str
    library: Library | None
    problem: str = ""


class _About(msgspec.Struct):
    source_sha256: str
    compiler: str
    flags: tuple[str, ...]
    cpu: str
    problem: str = ""


def find_compiler() -> Compiler | None:
    """$CC, cc, gcc or clang: the first that answers."""
    for command in (os.environ.get("CC", ""), "cc", "gcc", "clang"):
        words = tuple(shlex.split(command))
        if not words or not shutil.which(words[0]):
            continue
        try:
            told = subprocess.run([*words, "--version"], capture_output=True, text=True, timeout=TIMEOUT_S, check=True)
        except (OSError, subprocess.SubprocessError):
            continue
        return Compiler(words, told.stdout.partition("\n")[0])
    return None


def key_of(compiler: Compiler) -> str:
    """16 hexadecimal digits."""
    return _sha256("\0".join([source(), *compiler.command, compiler.version, *FLAGS, _cpu()]))[:16]


def lookup(key: str) -> Kernels | None:
    """What the cache has under a key; None when it has nothing."""
    if not re.fullmatch("[0-9a-f]{16}", key):  # it may come from a record that someone else made
        return None
    folder = cache_folder() / key
    try:
        about = msgspec.json.decode((folder / ABOUT).read_bytes(), type=_About)
    except FileNotFoundError:
        return None
    except (OSError, msgspec.MsgspecError) as problem:
        return Kernels(key, None, f"{folder / ABOUT} cannot be read ({problem})")
    if about.problem:
        return Kernels(key, None, about.problem)
    if about.source_sha256 != _sha256(source()):
        return Kernels(key, None, "it was compiled for another version of vinspect")
    if about.cpu != _cpu():
        return Kernels(key, None, "it was compiled for another processor")
    try:
        return Kernels(key, Library(folder / LIBRARY))
    except (OSError, AttributeError) as problem:
        return Kernels(key, None, f"{folder / LIBRARY} cannot be loaded ({problem})")


def build(compiler: Compiler) -> Kernels:
    """Compile, check, publish.  Raises OSError when the cache cannot be written."""
    key, folder = key_of(compiler), cache_folder()
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder) as work:
        made = Path(work) / key
        made.mkdir()
        (made / C_FILE).write_text(source())
        problem = _compile(compiler, made) or check(Library(made / LIBRARY))
        about = _About(_sha256(source()), compiler.version, FLAGS, _cpu(), problem)
        (made / ABOUT).write_bytes(msgspec.json.format(msgspec.json.encode(about), indent=1))
        try:
            made.rename(folder / key)
        except OSError:
            if not (folder / key / ABOUT).exists():
                raise
    found = lookup(key)
    assert found is not None
    return found


def build_now() -> Kernels:
    """The kernels, compiled if need be while the caller waits.  Raises BackendError: why they cannot be had."""
    compiler = find_compiler()
    if compiler is None:
        raise BackendError(
            "the compiled back end needs a C compiler, and neither $CC nor cc, gcc or clang is one; "
            "install one, or use `--backend numpy`, which gives the same results"
        )
    found = lookup(key_of(compiler))
    if found is None or found.problem:
        try:
            shutil.rmtree(cache_folder() / key_of(compiler), ignore_errors=True)
            found = build(compiler)
        except OSError as problem:
            raise BackendError(
                f"the compiled back end cannot be kept in {cache_folder()} ({problem}); "
                "set XDG_CACHE_HOME to a folder that can be written, or use `--backend numpy`"
            ) from None
    if found.problem:
        raise BackendError(f"the compiled back end cannot be used: {found.problem}; use `--backend numpy`")
    return found


def build_in_background() -> None:
    """Start building in a process of the lowest priority, which outlives this one; the next run finds the result."""
    global _background
    if _background is not None:
        return
    code = "import os; getattr(os, 'nice', int)(19); from vins_core.solver import compile; compile.build_quietly()"
    root = str(Path(__file__).parents[2])
    paths = os.pathsep.join([root, *filter(None, [os.environ.get("PYTHONPATH")])])
    try:
        _background = subprocess.Popen(
            [sys.executable, "-P", "-c", code],
            env=os.environ | {"PYTHONPATH": paths},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,  # Ctrl-C is for the run, not for it
        )
    except OSError:
        return


def build_quietly() -> None:
    compiler = find_compiler()
    if compiler is not None and lookup(key_of(compiler)) is None:
        build(compiler)


def cache_folder() -> Path:
    """`vinspect/compiled` in the user's cache."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "vinspect" / "compiled"


def _compile(compiler: Compiler, folder: Path) -> str:
    """Why there is no library; empty when there is."""
    command = [*compiler.command, *FLAGS, "-o", LIBRARY, C_FILE, "-lm"]
    try:
        done = subprocess.run(
            command, cwd=folder, capture_output=True, text=True, errors="replace", timeout=TIMEOUT_S, check=False
        )
    except (OSError, subprocess.TimeoutExpired) as problem:
        return f"{shlex.join(command)}: {problem}"
    if done.returncode:
        return f"{shlex.join(command)} failed: {' '.join(done.stderr.split())[:500]}"
    return ""


def _cpu() -> str:
    """Hash of the processor's name and of its instruction sets: what -march=native depends on."""
    try:
        facts = [line.partition(":") for line in Path("/proc/cpuinfo").read_text().splitlines()]
        known = sorted({fact for name, _, fact in facts if name.strip() in ("model name", "flags", "Features")})
    except OSError:
        known = [platform.processor(), platform.machine()]
    return _sha256("\n".join(known))


def _sha256(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()

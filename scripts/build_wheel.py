"""Build a wheel with compiled kernels for this environment.

They are for this Python, numba, NumPy and platform. The wheel is built from the sources, `hplan warmup` runs with it,
and the compiled kernels are added: for any processor with the instructions of x86-64-v3 (from 2013 on). With another
version of numba, NumPy or Python, or on an older processor, kernels are compiled as usual. The source distribution is
built, too.
"""

from __future__ import annotations

import argparse
import base64
import csv
import hashlib
import io
import os
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import tempfile
import time
import tomllib
import zipfile
from collections.abc import Sequence
from pathlib import Path

from hplan.apps.cli.main import COMMANDS
from hplan.apps.cli.warmup import ALL_KERNELS, compile_all
from hplan.base.kernels import made_for, portable_processor

ROOT = Path(__file__).resolve().parents[1]

#: Commands that are tried: all with `--help`, and some for real.
_TRIED = (
    "plan --out a",
    "certify a",
    "plan dense-canopy --deadline 500",
    "orchard --seed 3 --out row.yaml",
    "plan row.yaml",
)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=ROOT / "dist", metavar="DIR", help="folder (default: dist)")
    parser.add_argument("--processes", type=int, default=os.cpu_count(), metavar="N", help="at a time (default: all)")
    parser.add_argument("--try", action="store_true", dest="tried", help="run what is in it, outside the clone")
    arguments = parser.parse_args(argv)
    begin = time.perf_counter()
    with tempfile.TemporaryDirectory() as name:
        work = Path(name)
        source = built(ROOT, "sdist", arguments.out)
        pure = built(unpacked(source, work), "wheel", work)
        site = work / "site"
        with zipfile.ZipFile(pure) as archive:
            archive.extractall(site)
        count = add_kernels(site, work, arguments.processes)
        wheel = packed(site, pure.name, arguments.out)
        if arguments.tried:
            try_it(wheel, work / "tried")
    size = wheel.stat().st_size / 1e6
    print(f"{wheel}: {count} kernels, {size:.1f} MB, {time.perf_counter() - begin:.0f} s")
    return 0


def built(project: Path, what: str, folder: Path) -> Path:
    """Build `sdist` or `wheel` of a folder with hatchling."""
    build = [sys.executable, "-m", "hatchling", "build", "-t", what, "-d", str(folder.resolve())]
    subprocess.run(build, cwd=project, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    version = tomllib.loads((project / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
    return next(folder.glob(f"hplan-{version}" + (".tar.gz" if what == "sdist" else "-py3-none-any.whl")))


def unpacked(source: Path, work: Path) -> Path:
    """The unpacked source distribution; the wheel is built in it.

    This verifies that the source distribution is complete.
    """
    with tarfile.open(source) as archive:
        archive.extractall(work, filter="data")
    return work / source.name.removesuffix(".tar.gz")


def add_kernels(site: Path, work: Path, processes: int) -> int:
    """Compile kernels of an unpacked wheel and put them into it; how many there are."""
    cache = work / "cache"
    # `-P` keeps the working directory off the path, but not the clone of an editable install: so the site comes first.
    environment = {**portable_processor(), "PYTHONPATH": str(site), "NUMBA_CACHE_DIR": str(cache)}
    failed = compile_all(processes, lambda job, kernel: print(f"{job}: {kernel or 'done'}"), environment)
    if failed:
        raise SystemExit("\n".join(f"{job} failed: {message}" for job, message in failed.items()))
    kernels = site / "hplan" / "kernels"
    kernels.mkdir()
    for file in cache.rglob("*.nbc"):
        if (kernels / file.name).exists():
            raise RuntimeError(f"two kernels are called {file.name}")
        shutil.copyfile(file, kernels / file.name)
    (kernels / "made_for.txt").write_text(made_for() + "\n", encoding="utf-8")
    for each in site.rglob("__pycache__"):
        shutil.rmtree(each)
    count = len(list(kernels.glob("*.nbc")))
    if abs(count - ALL_KERNELS) > 0.1 * ALL_KERNELS:
        raise SystemExit(f"{count} kernels; hplan/apps/cli/warmup.py tells of {ALL_KERNELS}")
    return count


def packed(site: Path, pure: str, out: Path) -> Path:
    """The wheel of a folder, named and marked as one for this Python and platform."""
    python = f"cp{sys.version_info.major}{sys.version_info.minor}"
    # Apart from libm and numba's helpers kernels call clock_gettime, in glibc since 2.17: the tag (PEP 600).
    system = sysconfig.get_platform().replace("-", "_").replace(".", "_").replace("linux", "manylinux_2_17")
    tag = f"{python}-{python}-{system}"
    about = next(site.glob("*.dist-info"))
    (about / "RECORD").unlink()
    lines = (about / "WHEEL").read_text(encoding="utf-8").splitlines()
    kept = [line for line in lines if line and not line.startswith(("Tag:", "Root-Is-Purelib:"))]
    text = "\n".join([*kept, "Root-Is-Purelib: false", f"Tag: {tag}", ""])
    (about / "WHEEL").write_text(text, encoding="utf-8")
    wheel = out / pure.replace("py3-none-any", tag)
    record = io.StringIO()
    rows = csv.writer(record, lineterminator="\n")
    with zipfile.ZipFile(wheel, "w", zipfile.ZIP_DEFLATED) as archive:
        for file in sorted(path for path in site.rglob("*") if path.is_file()):
            name, data = file.relative_to(site).as_posix(), file.read_bytes()
            digest = base64.urlsafe_b64encode(hashlib.sha256(data).digest()).rstrip(b"=").decode()
            rows.writerow((name, f"sha256={digest}", len(data)))
            archive.writestr(zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0)), data, zipfile.ZIP_DEFLATED)
        rows.writerow((f"{about.name}/RECORD", "", ""))
        archive.writestr(f"{about.name}/RECORD", record.getvalue())
    return wheel


def try_it(wheel: Path, folder: Path) -> None:
    """Run commands of an installed wheel, with nothing else of hplan in sight, in an empty folder alone."""
    site, here = folder / "site", folder / "here"
    here.mkdir(parents=True)
    install = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--target", str(site), str(wheel)]
    subprocess.run(install, check=True)
    environment = {"PATH": os.defpath, "PYTHONPATH": str(site), "HOME": os.devnull, "PYTHONDONTWRITEBYTECODE": "1"}
    readme = (ROOT / "README.md").read_text(encoding="utf-8").partition("```python\n")[2].partition("```")[0]
    commands = [*(f"{name} --help" for name in COMMANDS), *_TRIED]
    # Further programs to test: the README's program, and an arm that is not planar.
    any_arm = "import hplan.apps.cli.warmup as warmup; warmup.warm_up_any_arm()"
    programs = [*(["-m", "hplan.apps.cli", *words.split()] for words in commands), ["-c", readme], ["-c", any_arm]]
    for words in programs:
        begin = time.perf_counter()
        command = [sys.executable, "-P", *words]
        done = subprocess.run(command, cwd=here, env=environment, capture_output=True, text=True, check=False)
        print(f"{' '.join(words)[:60]!r}: {time.perf_counter() - begin:.1f} s")
        if done.returncode or done.stderr:
            raise SystemExit(f"exit status {done.returncode}\n{done.stdout}{done.stderr}")
    if compiled := [file.name for file in folder.rglob("*.nbc") if file.parent != site / "hplan" / "kernels"]:
        raise SystemExit(f"compiled although they came with the wheel: {', '.join(compiled)}")


if __name__ == "__main__":
    sys.exit(main())

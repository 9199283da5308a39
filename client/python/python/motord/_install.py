"""The command that installs an extra of this package, which no registry has."""

import json
import re
import shlex
from importlib.metadata import Distribution, PackageNotFoundError, distribution, requires
from urllib.parse import unquote, urlsplit


def command(extra: str) -> str:
    """Returns the pip command for an extra, with the file of the installed wheel."""
    return f"pip install {shlex.quote(f'{_wheel()}[{extra}]')}"


def is_installed(extra: str) -> bool:
    """Returns whether each package of an extra is installed, whatever its version."""
    try:
        needed = requires("motord") or []
    except PackageNotFoundError:
        return False
    names = [re.match(r"[\w.-]+", line) for line in needed if re.search(rf"""extra == ['"]{extra}['"]""", line)]
    return all(name and _is_present(name.group()) for name in names)


def _is_present(package: str) -> bool:
    try:
        return bool(distribution(package))
    except PackageNotFoundError:
        return False


def _wheel() -> str:
    """The path from which pip installed the wheel; without it, its name in the present directory."""
    try:
        installed = distribution("motord")
    except PackageNotFoundError:
        return "./motord-VERSION.whl"
    source = urlsplit(str(json.loads(installed.read_text("direct_url.json") or "{}").get("url", "")))
    if source.scheme == "file" and source.path.endswith(".whl"):
        return unquote(source.path)
    return f"./motord-{installed.version}-{_tag(installed)}.whl"


def _tag(installed: Distribution) -> str:
    lines = (installed.read_text("WHEEL") or "").splitlines()
    return next((line.removeprefix("Tag: ") for line in lines if line.startswith("Tag: ")), "TAG")

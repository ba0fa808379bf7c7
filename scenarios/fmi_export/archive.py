"""The FMU as a file: description, sources, libraries and a page on what it contains."""

from __future__ import annotations

import hashlib
import io
import tempfile
import uuid
import zipfile
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Final

from scenarios.fmi_export.binaries import library, library_path
from scenarios.fmi_export.exported import Exported, exported_plant
from scenarios.fmi_export.model import PlantModel
from scenarios.fmi_export.model_description import build_description, model_description
from scenarios.results.files import replacing

_EPOCH: Final = (1980, 1, 1, 0, 0, 0)  # of every entry: the same plant gives the same file


def write_fmu(path: Path, model: PlantModel, version: int, platforms: Sequence[str], *, optimisation: int = 2) -> None:
    """Write the FMU of a plant with its libraries; nothing is left of one that fails.

    Raises:
        ValueError: one line, if a library cannot be compiled.
        OSError: if the file cannot be written.
    """
    with replacing(path) as unfinished:
        unfinished.write_bytes(fmu_bytes(exported_plant(model, version), version, platforms, optimisation=optimisation))


def fmu_bytes(exported: Exported, version: int, platforms: Sequence[str], *, optimisation: int = 2) -> bytes:
    """Content of an FMU with its libraries.

    Raises:
        ValueError: one line, if a library cannot be compiled.
    """
    token = _token(exported, version)
    sources = {**exported.sources, "token.h": f'#define TOKEN "{token}"\n'}
    compiled = sorted(name for name in sources if name.endswith(".c"))
    files: dict[str, bytes] = {
        "modelDescription.xml": model_description(exported, version, token, compiled),
        "documentation/index.html": _page(exported),
        **{f"resources/{name}": content for name, content in exported.resources.items()},
        **{f"sources/{name}": text.encode() for name, text in sources.items()},
    }
    if version == 3:
        files["sources/buildDescription.xml"] = build_description(exported.identifier, compiled)
    with tempfile.TemporaryDirectory(prefix="offtrack-fmu-") as folder:
        for name, text in sources.items():
            Path(folder, name).write_text(text, encoding="utf-8")
        for platform in platforms:
            content = library(platform, Path(folder), compiled, optimisation)
            files[library_path(platform, version, exported.identifier)] = content
    return zipped(files)


def _token(exported: Exported, version: int) -> str:
    """Token that changes with the sources, names and start values, and with the resources."""
    digest = hashlib.sha256("\0".join([*exported.sources.values(), str(version)]).encode())
    for name, content in sorted(exported.resources.items()):
        digest.update(name.encode() + b"\0" + content)
    return "{" + str(uuid.uuid5(uuid.NAMESPACE_URL, digest.hexdigest())) + "}"


def _page(exported: Exported) -> bytes:
    from jinja2 import Environment

    template = (resources.files("scenarios.fmi_export") / "page.html.j2").read_text(encoding="utf-8")
    page = Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True).from_string(template)
    return page.render(model=exported).encode()


def zipped(files: Mapping[str, bytes]) -> bytes:
    """A zip file of these members, the same for the same content."""
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, member in files.items():
            entry = zipfile.ZipInfo(name, _EPOCH)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = (0o755 if name.startswith("binaries/") else 0o644) << 16
            archive.writestr(entry, member)
    return content.getvalue()

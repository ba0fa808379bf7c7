"""The FMU as a file: description, sources, libraries and a page on what it contains."""

from __future__ import annotations

import hashlib
import tempfile
import uuid
import zipfile
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Final

from scenarios.fmi_export.binaries import library, library_path
from scenarios.fmi_export.c_files import c_files, plant_header
from scenarios.fmi_export.model import PlantModel
from scenarios.fmi_export.model_description import build_description, model_description
from scenarios.results.files import replacing

_EPOCH: Final = (1980, 1, 1, 0, 0, 0)  # of every entry: the same plant gives the same file


def write_fmu(path: Path, model: PlantModel, version: int, platforms: Sequence[str], *, optimisation: int = 2) -> None:
    """Write an FMU with its libraries; nothing is left of one that fails.

    Raises:
        ValueError: one line, if a library cannot be compiled.
        OSError: if the file cannot be written.
    """
    sources = _sources(model, version)
    compiled = sorted(name for name in sources if name.endswith(".c"))
    token = _token(model, version, sources)
    sources["plant.h"] = plant_header(model.interface, model.programs, model.gear) + f'#define TOKEN "{token}"\n'
    files: dict[str, bytes] = {
        "modelDescription.xml": model_description(model, version, token, compiled),
        "documentation/index.html": _page(model),
        **{f"sources/{name}": text.encode() for name, text in sources.items()},
    }
    if version == 3:
        files["sources/buildDescription.xml"] = build_description(model, compiled)
    with tempfile.TemporaryDirectory(prefix="offtrack-fmu-") as folder:
        for name, text in sources.items():
            Path(folder, name).write_text(text, encoding="utf-8")
        for platform in platforms:
            content = library(platform, Path(folder), compiled, optimisation)
            files[library_path(platform, version, model.identifier)] = content
    with replacing(path) as unfinished:
        _zip(unfinished, files)


def _sources(model: PlantModel, version: int) -> dict[str, str]:
    return c_files(model.identifier, model.kind, version, model.programs, model.defined)


def _token(model: PlantModel, version: int, sources: Mapping[str, str]) -> str:
    """Token that changes with the sources, and with names and start values."""
    content = "\0".join([*sources.values(), plant_header(model.interface, model.programs, model.gear), str(version)])
    return "{" + str(uuid.uuid5(uuid.NAMESPACE_URL, hashlib.sha256(content.encode()).hexdigest())) + "}"


def _page(model: PlantModel) -> bytes:
    from jinja2 import Environment

    template = (resources.files("scenarios.fmi_export") / "page.html.j2").read_text(encoding="utf-8")
    page = Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True).from_string(template)
    return page.render(model=model, variables=model.interface.variables()).encode()


def _zip(path: Path, files: Mapping[str, bytes]) -> None:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            entry = zipfile.ZipInfo(name, _EPOCH)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = (0o755 if name.startswith("binaries/") else 0o644) << 16
            archive.writestr(entry, content)

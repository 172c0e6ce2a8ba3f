"""`croissant.json`, the card for machines: MLCommons Croissant 1.1 with the fields of its Responsible-AI extension.

The card also has the SHA-256 of `samples.parquet`.
"""

from __future__ import annotations

import datetime
import re
import unicodedata
from typing import Any

from datagen.store.arrays import GROUP
from datagen.store.description import Description
from datagen.store.files import sha256_of
from datagen.store.location import Location, opened
from datagen.store.manifest import Manifest
from datagen.store.schema import Field
from datagen.store.table import COLUMNS, TABLE, parquet_file

NO_LICENSE = "https://choosealicense.com/no-permission/"
"""The licence of a dataset whose configuration names none: all rights are reserved."""
_CONTEXT: dict[str, Any] = {
    "@language": "en", "@vocab": "https://schema.org/", "arrayShape": "cr:arrayShape", "citeAs": "cr:citeAs",
    "column": "cr:column", "conformsTo": "dct:conformsTo", "containedIn": "cr:containedIn",
    "cr": "http://mlcommons.org/croissant/", "data": {"@id": "cr:data", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"}, "dct": "http://purl.org/dc/terms/",
    "description": {"@container": "@language"}, "equivalentProperty": "cr:equivalentProperty",
    "examples": {"@id": "cr:examples", "@type": "@json"}, "extract": "cr:extract", "field": "cr:field",
    "fileObject": "cr:fileObject", "fileProperty": "cr:fileProperty", "fileSet": "cr:fileSet", "format": "cr:format",
    "includes": "cr:includes", "isArray": "cr:isArray", "isLiveDataset": "cr:isLiveDataset",
    "jsonPath": "cr:jsonPath", "key": "cr:key", "md5": "cr:md5", "name": {"@container": "@language"},
    "parentField": "cr:parentField", "path": "cr:path", "rai": "http://mlcommons.org/croissant/RAI/",
    "recordSet": "cr:recordSet", "references": "cr:references", "regex": "cr:regex", "repeated": "cr:repeated",
    "replace": "cr:replace", "samplingRate": "cr:samplingRate", "sc": "https://schema.org/",
    "separator": "cr:separator", "source": "cr:source", "subField": "cr:subField", "transform": "cr:transform",
}  # fmt: skip
_TYPES = {"string": "sc:Text", "double": "sc:Float", "bool": "sc:Boolean"}
_RESPONSIBLE = {
    "rai:dataCollectionType": "Software Collection",
    "rai:dataAnnotationProtocol": "Labels are computed from the geometry of each room.",
    "rai:dataBiases": "Rooms, objects and materials are as likely as the configuration makes them, not as they are "
    "in buildings. Reflectances of materials are measured or estimated, their glossy lobes estimated.",
    "rai:dataLimitations": "Nothing transmits light; further limits are listed in datagen's README.md. The error of "
    "each transient stands in samples.parquet.",
    "rai:dataUseCases": "To train and compare methods of non-line-of-sight imaging; no substitute for a measurement.",
    "rai:dataSocialImpact": "Seeing around corners serves rescue and road safety, and could serve surveillance.",
    "rai:personalSensitiveInformation": "None: figures of persons are parametric shapes.",
}
_IMPORTED = _RESPONSIBLE | {
    "rai:dataCollectionType": "Others",
    "rai:dataAnnotationProtocol": "There are no labels.",
    "rai:dataBiases": "Those of who chose what to capture.",
    "rai:dataLimitations": "What the detector was, and what was hidden, is not part of the files.",
    "rai:dataUseCases": "To try and compare methods of non-line-of-sight imaging.",
    "rai:personalSensitiveInformation": "Not known: people may have been captured.",
}


def croissant(root: Location, dataset: Description) -> dict[str, Any]:
    """The content of `croissant.json`: the files, a record for each scene, and a record for each array.

    The version of the dataset is (format).(scenes).0, because a dataset that grows stays compatible. Its date
    is that of its last shard.
    """
    manifest = dataset.manifest
    config, fields = manifest.config, manifest.schema.fields
    made = datetime.datetime.fromtimestamp(max(finished for _, finished in dataset.times), datetime.UTC)
    terms = config["license"] or NO_LICENSE
    what = "Imported" if manifest.imported else "Simulated"
    name = config["name"]
    made_by = (
        f"datagen {manifest.made_by['datagen']}, seed {manifest.seed}, configuration {manifest.fingerprint[:12]}"
    )
    cite = (
        f"@misc{{{_bibtex_key(name)}, title = {{{_bibtex_text(name)}: {what.lower()} non-line-of-sight single-photon "
        f"measurements}}, "
        f"year = {{{made.year}}}, note = {{{made_by}}}}}"
    )
    return {
        "@context": _CONTEXT, "@type": "sc:Dataset", "conformsTo": "http://mlcommons.org/croissant/1.1",
        "name": name,
        "description": config["description"] or f"{what} non-line-of-sight single-photon measurements.",
        "version": f"{manifest.format}.{manifest.schema.scenes}.0",
        # A configuration has an address or a name of the SPDX list.
        "license": terms if "://" in terms else f"https://spdx.org/licenses/{terms}.html",
        "url": "https://doi.org/10.3390/s24206522", "citeAs": cite, "datePublished": made.date().isoformat(),
        "rai:dataCollection": dataset.origin,
        **(_IMPORTED if manifest.imported else _RESPONSIBLE),
        "distribution": [_table_file(root), *map(_shards, fields)],
        "recordSet": [_scenes(root), _arrays(manifest)],
    }  # fmt: skip


def _bibtex_key(name: str) -> str:
    """The name of a dataset as a key that BibTeX takes: letters and digits of ASCII, and some signs between them."""
    plain = unicodedata.normalize("NFKD", name).encode("ascii", "ignore").decode()
    return re.sub(r"[^A-Za-z0-9._:-]+", "-", plain).strip("-.:_") or "dataset"


def _bibtex_text(text: str) -> str:
    """Text as BibTeX and LaTeX print it. Braces and backslashes are left out: BibTeX counts braces, escaped or
    not."""
    return re.sub(r"([&%$#_])", r"\\\1", re.sub(r"[{}\\~^]", "", text))


def _table_file(root: Location) -> dict[str, Any]:
    return {
        "@type": "cr:FileObject", "@id": TABLE, "name": TABLE, "description": "One row a scene.",
        "contentUrl": TABLE, "encodingFormat": "application/x-parquet", "sha256": sha256_of(root / TABLE),
    }  # fmt: skip


def _shards(field: Field) -> dict[str, Any]:
    axes = f"Zarr v3 array ({', '.join(field.dims)}) of {field.dtype}, {field.unit}"
    return {
        "@type": "cr:FileSet", "@id": f"{GROUP}/{field.name}", "name": field.name,
        "description": f"{axes}: {field.meaning}.", "encodingFormat": "application/vnd.zarr",
        "includes": f"{GROUP}/{field.name}/**",
    }  # fmt: skip


def _scenes(root: Location) -> dict[str, Any]:
    with opened(root / TABLE) as (_, file):
        described = parquet_file(file).schema_arrow
    columns = [
        {
            "@type": "cr:Field", "@id": f"scenes/{column.name}", "name": column.name,
            "description": COLUMNS.get(column.name, COLUMNS["others"]),
            "dataType": _TYPES.get(str(column.type), "sc:Integer"),
            "source": {"fileObject": {"@id": TABLE}, "extract": {"column": column.name}},
        }
        for column in described
    ]  # fmt: skip
    return {
        "@type": "cr:RecordSet", "@id": "scenes", "name": "scenes",
        "description": "One record a scene: its split, what was drawn, error estimates, statistics, digests.",
        "key": {"@id": "scenes/scene"}, "field": columns,
    }  # fmt: skip


def _arrays(manifest: Manifest) -> dict[str, Any]:
    names = ("name", "path", "axes", "shape", "dtype", "unit", "meaning")
    data = [
        {
            "arrays/name": field.name, "arrays/path": f"{GROUP}/{field.name}", "arrays/axes": ", ".join(field.dims),
            "arrays/shape": ", ".join(map(str, (manifest.schema.scenes, *field.shape))),
            "arrays/dtype": field.dtype, "arrays/unit": field.unit, "arrays/meaning": field.meaning,
        }
        for field in manifest.schema.fields
    ]  # fmt: skip
    return {
        "@type": "cr:RecordSet", "@id": "arrays", "name": "arrays",
        "description": "One record an array of the Zarr group; scene i is index i of the first axis.",
        "field": [
            {"@type": "cr:Field", "@id": f"arrays/{name}", "name": name, "dataType": "sc:Text"} for name in names
        ],
        "data": data,
    }  # fmt: skip

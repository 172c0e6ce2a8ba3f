"""One hash of a dataset's values, that a paper can print."""

from __future__ import annotations

import hashlib

from datagen.errors import CheckError
from datagen.store.manifest import read_manifest
from datagen.store.places import Place, place
from datagen.store.reader import DatasetReader
from datagen.store.verify import committed


def dataset_digest(path: str | Place) -> str:
    """Hex SHA-256 of every decoded value of a dataset, the same for any division into shards, compression, order of
    building and interruption.

    Of each field by name: a line `name dtype shape` (of one scene), then of each scene in order the SHA-256 of its
    values, little-endian in C order, or 32 zero bytes where it could not be made. All values are read, and compared
    with the digests taken when they were written.

    Raises `InputError` when the folder is no dataset, `CheckError` when it is not complete or not as it was written.
    """
    root = place(path)
    manifest = read_manifest(root)
    schema, records = manifest.schema, committed(root, manifest)
    if len(records) < schema.shards:
        raise CheckError(
            f"{root}: {schema.shards - len(records)} of {schema.shards} shards are missing or damaged; run the same "
            "`datagen build` again to make them"
        )
    scenes = sorted((scene for record in records for scene in record.scenes), key=lambda scene: scene.index)
    reader, whole = DatasetReader(root, manifest, schema.by_name), hashlib.sha256()
    for name, field in sorted(schema.by_name.items()):
        whole.update(f"{name} {field.dtype} {' '.join(map(str, field.shape))}\n".encode())
        for scene in scenes:
            if scene.failure is None:
                # Read in order to be compared: the digest that the record states is then that of the values.
                reader.read(name, [scene.index])
            whole.update(bytes.fromhex(scene.digests[name]) if scene.failure is None else bytes(32))
    return whole.hexdigest()

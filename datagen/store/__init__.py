"""The dataset on disk: `dataset.json`, cards, table, commit records and the Zarr group."""

from datagen.store.card import write_card
from datagen.store.description import Description
from datagen.store.files import check_writable
from datagen.store.growth import growth_line, growth_of, standing_shards
from datagen.store.manifest import Manifest, read_manifest
from datagen.store.prepare import build_folders, forget_complete, is_fresh, planned_manifest, prepare
from datagen.store.reader import DatasetReader
from datagen.store.record import ShardRecord, running_path, writing_path
from datagen.store.schema import Field, Schema, schema_of
from datagen.store.shard import discard_shard, write_shard
from datagen.store.verify import Verification, committed_records, each_committed, finish, verify

__all__ = [
    "DatasetReader", "Description", "Field", "Manifest", "Schema", "ShardRecord", "Verification",
    "build_folders", "check_writable", "committed_records", "discard_shard", "each_committed", "finish",
    "forget_complete", "growth_line", "growth_of", "is_fresh", "planned_manifest", "prepare", "read_manifest",
    "running_path", "schema_of", "standing_shards", "verify", "write_card", "write_shard", "writing_path",
]  # fmt: skip

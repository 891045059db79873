"""Read and write bags with the C++ library of rosbag2."""

import rosbag2_py

MCAP = "mcap"
PRESETS = ("none", "fastwrite", "zstd_fast", "zstd_small")


def read(folder, storage=MCAP):
    """Return (topic, bytes, log time) of each message, in the order of rosbag2."""
    reader = rosbag2_py.SequentialReader()
    reader.open(_storage(folder, storage_id=storage), rosbag2_py.ConverterOptions("", ""))
    found = []
    while reader.has_next():
        topic, data, time = reader.read_next()
        found.append((topic, bytes(data), time))
    return found


def metadata(folder, storage=MCAP):
    """Return the metadata of a bag by rosbag2's `info`."""
    return rosbag2_py.Info().read_metadata(str(folder), storage)


def write(folder, messages, types, *, storage=MCAP, compression="", **options):
    """Write (topic, bytes, log time); ``compression``: FILE or MESSAGE, of rosbag2; ``options``: of its storage."""
    if compression:
        mode = getattr(rosbag2_py.CompressionMode, compression)
        writer = rosbag2_py.SequentialCompressionWriter(rosbag2_py.CompressionOptions("zstd", mode, 1, 1))
    else:
        writer = rosbag2_py.SequentialWriter()
    writer.open(_storage(folder, storage_id=storage, **options), rosbag2_py.ConverterOptions("", ""))
    for number, (topic, kind) in enumerate(sorted(types.items())):
        writer.create_topic(rosbag2_py.TopicMetadata(number, topic, kind, "cdr"))
    for topic, data, time in messages:
        writer.write(topic, data, time)
    # Deleting closes it: the compressing writer does not have close().
    del writer


def _storage(folder, **options):
    return rosbag2_py.StorageOptions(uri=str(folder), **options)

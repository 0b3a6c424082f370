"""Subtrees of a chunk file ready for rays, as many as a bound on memory lets be kept."""

from __future__ import annotations

from collections import OrderedDict

from workbench.raytracing.chunk_file import ChunkFile, joined_chunks
from workbench.raytracing.embree_scene import EmbreeScene, scene_bytes


class GeometryCache:
    """Scenes by their node; those least recently used go first.

    Attributes
    ----------
    file : where they come from.
    most_bytes : that all kept scenes may take; one is kept whatever it takes.
    bytes_read, loads : from the file so far.
    bytes_held, most_bytes_held : of memory, by what scenes are known to take, now and at most.
    """

    def __init__(self, file: ChunkFile, most_bytes: int) -> None:
        self.file, self.most_bytes = file, most_bytes
        self.bytes_read = self.loads = self.bytes_held = self.most_bytes_held = 0
        self._scenes: OrderedDict[int, EmbreeScene] = OrderedDict()

    def __contains__(self, node: int) -> bool:
        return node in self._scenes

    def scene(self, node: int) -> EmbreeScene:
        """The triangles below a node."""
        if node in self._scenes:
            self._scenes.move_to_end(node)
            return self._scenes[node]
        record = self.file.tree.nodes[node]
        # Room is made before the new scene takes it.
        self._make_room(scene_bytes(int(record["triangles"])))
        first, count = int(record["first"]), int(record["count"])
        scene = EmbreeScene(joined_chunks(self.file.read(first, count)))
        self.bytes_read += self.file.stored_bytes(first, count)
        self.loads += 1
        self._scenes[node] = scene
        self.bytes_held += scene.bytes
        self.most_bytes_held = max(self.most_bytes_held, self.bytes_held)
        return scene

    def _make_room(self, needed: int) -> None:
        while self._scenes and self.bytes_held + needed > self.most_bytes:
            _, dropped = self._scenes.popitem(last=False)
            self.bytes_held -= dropped.bytes

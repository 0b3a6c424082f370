// Binary glTF as the workbench writes it: one mesh, a material and a picture per part.

import { SourceError } from "./source.js";

const MAGIC = 0x46546c67;
const ARRAYS = { 5120: Int8Array, 5121: Uint8Array, 5122: Int16Array, 5123: Uint16Array, 5125: Uint32Array, 5126: Float32Array };
const PARTS = { SCALAR: 1, VEC2: 2, VEC3: 3, VEC4: 4 };

/**
 * Parts of a mesh and its place.
 *
 * Returns {fromPositions: [x, y, z] to add to positions for the user's coordinates, parts:
 * [{attributes: name → {data, size, stride, type, count}, indices, picture: Blob | null}]}.
 */
export function readGlb(buffer, name) {
  const broken = (why) => new SourceError(`${name} is damaged: ${why}. Publish it again.`);
  const header = new DataView(buffer);
  if (buffer.byteLength < 20 || header.getUint32(0, true) !== MAGIC) throw broken("it is no GLB");
  if (header.getUint32(8, true) > buffer.byteLength) throw broken("its end is missing");
  const textBytes = header.getUint32(12, true);
  if (20 + textBytes > buffer.byteLength) throw broken("its end is missing");
  let told;
  try {
    told = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 20, textBytes)));
  } catch {
    throw broken("its description is no JSON");
  }
  const start = 20 + textBytes + 8;
  const room = buffer.byteLength - start;
  const bytesOf = (view) => {
    const offset = view?.byteOffset ?? 0;
    if (!view || offset + view.byteLength > room) throw broken("a part reaches beyond its end");
    return [start + offset, view.byteLength];
  };
  const accessor = (index) => {
    const { bufferView, byteOffset = 0, componentType, count, type } = told.accessors[index];
    const view = told.bufferViews[bufferView];
    const [at, bytes] = bytesOf(view);
    const size = PARTS[type];
    const each = size * ARRAYS[componentType].BYTES_PER_ELEMENT;
    const stride = view.byteStride ?? each;
    if (byteOffset + (count - 1) * stride + each > bytes) throw broken("an array is too short");
    return { data: new Uint8Array(buffer, at + byteOffset, bytes - byteOffset), size, stride, type: componentType, count };
  };
  try {
    const parts = told.meshes[0].primitives.map((primitive) => {
      const attributes = Object.fromEntries(
        Object.entries(primitive.attributes).map(([key, index]) => [key, accessor(index)]),
      );
      const indices = accessor(primitive.indices);
      const texture = told.materials?.[primitive.material]?.pbrMetallicRoughness?.baseColorTexture;
      let picture = null;
      if (texture) {
        const image = told.images[told.textures[texture.index].source];
        const [at, bytes] = bytesOf(told.bufferViews[image.bufferView]);
        picture = new Blob([new Uint8Array(buffer, at, bytes)], { type: image.mimeType });
      }
      return { attributes, indices, picture };
    });
    return { fromPositions: told.asset.extras?.world_from_positions ?? [0, 0, 0], parts };
  } catch (error) {
    if (error instanceof SourceError) throw error;
    throw broken("its description does not fit");
  }
}

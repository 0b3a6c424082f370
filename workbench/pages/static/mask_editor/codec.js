// Masks as they travel and as they are kept: gzip of one byte a pixel.

export async function packed(data) {
  return through(data, new CompressionStream("gzip"));
}

export async function unpacked(bytes) {
  return through(bytes, new DecompressionStream("gzip"));
}

async function through(bytes, transform) {
  const stream = new Blob([bytes]).stream().pipeThrough(transform);
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

export function same(a, b) {
  return a.length === b.length && a.every((value, index) => value === b[index]);
}

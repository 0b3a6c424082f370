// CRC-32 as zip and PNG have it.

const TABLE = Uint32Array.from({ length: 256 }, (_, value) => {
  let c = value;
  for (let k = 0; k < 8; k++) c = c & 1 ? 0xedb88320 ^ (c >>> 1) : c >>> 1;
  return c;
});

/** Of a buffer, as a number from 0 up to 2³² − 1. */
export function crc32(buffer) {
  let c = 0xffffffff;
  for (const byte of new Uint8Array(buffer)) c = TABLE[(c ^ byte) & 255] ^ (c >>> 8);
  return (c ^ 0xffffffff) >>> 0;
}

// CRC-32 as zip and PNG have it, also of what comes in pieces.

const TABLE = Uint32Array.from({ length: 256 }, (_, value) => {
  let c = value;
  for (let k = 0; k < 8; k++) c = c & 1 ? 0xedb88320 ^ (c >>> 1) : c >>> 1;
  return c;
});

/** Of bytes that follow others whose CRC-32 is `before`. */
export function crc32(bytes, before = 0) {
  let c = ~before;
  for (const byte of bytes) c = TABLE[(c ^ byte) & 255] ^ (c >>> 8);
  return ~c >>> 0;
}

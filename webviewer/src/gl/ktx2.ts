/**
 * KTX2 pages as farfield writes them (services/farfield/placementdb/ktx2.py): R8G8B8A8_SRGB, Zstandard, no layers.
 *
 * The decompressor (three.js' build of Zstandard, WebAssembly) is loaded with the first such page.
 */
const MAGIC = [0xab, 0x4b, 0x54, 0x58, 0x20, 0x32, 0x30, 0xbb, 0x0d, 0x0a, 0x1a, 0x0a];
const HEAD = [43, 1, 0, 0, 0, 0, 1, 0, 2]; // vkFormat, typeSize, width, height, depth, layers, faces, levels, Zstandard
const INDEX_AT = 80;

type Unpack = (packed: Uint8Array, bytes: number) => Uint8Array;
let loading: Promise<Unpack> | null = null;

async function load(): Promise<Unpack> {
  const { ZSTDDecoder } = await import("three/addons/libs/zstddec.module.js");
  const decoder = new ZSTDDecoder();
  await decoder.init();
  return (packed, bytes) => decoder.decode(packed, bytes);
}

/** The levels, finest first, of a file that must have these sides; throws where it is no such file. */
export async function readKtx2(bytes: Uint8Array, sides: number[]): Promise<Uint8Array[]> {
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  const wanted = HEAD.slice();
  wanted[2] = wanted[3] = sides[0];
  wanted[7] = sides.length;
  const sound = bytes.length >= INDEX_AT + 24 * sides.length && MAGIC.every((b, i) => bytes[i] === b);
  if (!sound || wanted.some((word, i) => view.getUint32(12 + 4 * i, true) !== word)) throw new Error("it is no KTX2 page");
  loading ??= load();
  const unpack = await loading;
  return sides.map((side, k) => {
    const [at, length, size] = [0, 8, 16].map((i) => Number(view.getBigUint64(INDEX_AT + 24 * k + i, true)));
    if (at + length > bytes.length || size !== 4 * side * side) throw new Error(`level ${k} of it is not where it says`);
    const level = unpack(bytes.subarray(at, at + length), size);
    if (level.length !== size) throw new Error(`level ${k} of it does not unpack`);
    return level;
  });
}

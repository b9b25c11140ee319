/**
 * Squeezed containers (`.ffz`): a zlib stream that the browser inflates itself; columns written as byte planes, or as planes
 * of the differences of rows, are put together again. The twin of services/farfield/placementdb/squeeze.py.
 */
import { unpack, type Column, type Container } from "./columns";
import { ColumnsAltered, ColumnsTruncated } from "./errors";

/** The container of a file: as it is, or squeezed, which its name says. `expanded`: bytes when inflated. */
export async function unpackFile(bytes: Uint8Array, where: string, expanded?: number): Promise<Container> {
  if (!where.endsWith(".ffz")) return unpack(bytes, where);
  const container = unpack(await inflate(bytes, where, expanded ?? 0), where);
  const codings = container.meta.codings;
  if (codings === null || typeof codings !== "object") throw new ColumnsAltered(where, "it does not say how its columns are written");
  for (const [name, coding] of Object.entries(codings)) {
    const column = container.columns.get(name);
    if (!column || !column.shape.length || (coding !== "planes" && coding !== "delta")) {
      throw new ColumnsAltered(where, `column ${name} is written in an unknown way`);
    }
    container.columns.set(name, fromPlanes(column, coding === "delta"));
  }
  return container;
}

/** Stops as soon as more comes out than `expanded`: a small file may inflate to a thousand times its size. */
async function inflate(bytes: Uint8Array, where: string, expanded: number): Promise<Uint8Array> {
  let length = 0;
  const limit = new TransformStream<Uint8Array, Uint8Array>({
    transform(part, out) {
      length += part.length;
      if (length > expanded) throw new RangeError("too long");
      out.enqueue(part);
    },
  });
  const inflated = new Blob([bytes as Uint8Array<ArrayBuffer>]).stream().pipeThrough(new DecompressionStream("deflate")).pipeThrough(limit);
  let out: Uint8Array;
  try {
    out = new Uint8Array(await new Response(inflated).arrayBuffer());
  } catch {
    throw new ColumnsAltered(where, length > expanded ? `it does not inflate to ${expanded} bytes` : "it does not inflate");
  }
  if (out.length < expanded) throw new ColumnsTruncated(where, out.length, expanded);
  return out;
}

function fromPlanes(column: Column, delta: boolean): Column {
  const { data, shape } = column;
  const rows = shape[0];
  const size = data.BYTES_PER_ELEMENT;
  const make = data.constructor as new (n: number) => Column["data"];
  const restored = new make(data.length);
  const from = new Uint8Array(data.buffer, data.byteOffset, data.byteLength);
  const to = new Uint8Array(restored.buffer);
  const width = rows ? to.length / rows : 0;
  if (!delta) for (let k = 0; k < width; k++) for (let i = 0, at = k; i < rows; i++, at += width) to[at] = from[k * rows + i];
  else if (size === 4) sum4(from, new Uint32Array(restored.buffer), rows);
  else for (let k = 0; k < width; k += size) sum(from, to, rows, k, size, width);
  return { ...column, data: restored };
}

/** Four bytes wide, the most frequent: in integers of the machine. */
function sum4(from: Uint8Array, to: Uint32Array, rows: number): void {
  const width = rows ? to.length / rows : 0;
  for (let c = 0; c < width; c++) {
    const a = 4 * c * rows;
    let total = 0;
    for (let i = 0, at = c; i < rows; i++, at += width) {
      const z = from[a + i] | (from[a + rows + i] << 8) | (from[a + 2 * rows + i] << 16) | (from[a + 3 * rows + i] << 24);
      total = (total + ((z >>> 1) ^ -(z & 1))) | 0;
      to[at] = total;
    }
  }
}

/** Any width, byte by byte with carry: bytes [k, k + size) of every row. */
function sum(from: Uint8Array, to: Uint8Array, rows: number, k: number, size: number, width: number): void {
  for (let i = 0; i < rows; i++) {
    const flip = from[k * rows + i] & 1 ? 0xff : 0;
    let carry = 0;
    for (let b = 0; b < size; b++) {
      const low = from[(k + b) * rows + i] >> 1;
      const high = b + 1 < size ? (from[(k + b + 1) * rows + i] & 1) << 7 : 0;
      const total = ((low | high) ^ flip) + (i ? to[(i - 1) * width + k + b] : 0) + carry;
      to[i * width + k + b] = total;
      carry = total >> 8;
    }
  }
}

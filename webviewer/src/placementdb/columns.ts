/**
 * The container of `services/farfield/columns.py`: named, typed arrays, mapped without copying.
 *
 * Layout: 8 bytes FARFIELD, uint32 version, uint32 header length, header (JSON), columns at 8-byte aligned offsets.
 */
import { ColumnsAltered, ColumnsTooNew, ColumnsTruncated, NotColumns } from "./errors";

export const CONTAINER_VERSION = 1;

const TYPES = {
  "|b1": Uint8Array,
  "|i1": Int8Array,
  "|u1": Uint8Array,
  "<i2": Int16Array,
  "<u2": Uint16Array,
  "<i4": Int32Array,
  "<u4": Uint32Array,
  "<i8": BigInt64Array,
  "<u8": BigUint64Array,
  "<f4": Float32Array,
  "<f8": Float64Array,
} as const;

export type Dtype = keyof typeof TYPES;
export type ColumnArray = InstanceType<(typeof TYPES)[Dtype]>;
export interface Column {
  dtype: Dtype;
  shape: number[];
  data: ColumnArray;
}
export interface Container {
  kind: string;
  meta: Record<string, unknown>;
  columns: Map<string, Column>;
}

/** Columns are views into `bytes`, which must lie at an 8-byte aligned offset of its buffer (as fetched ones do). */
export function unpack(bytes: Uint8Array, where: string): Container {
  const magic = "FARFIELD";
  if (bytes.length < 16) throw new NotColumns(where);
  for (let i = 0; i < 8; i++) if (bytes[i] !== magic.charCodeAt(i)) throw new NotColumns(where);
  if (bytes.byteOffset % 8 !== 0) bytes = bytes.slice();
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.length);
  const version = view.getUint32(8, true);
  if (version !== CONTAINER_VERSION) throw new ColumnsTooNew(where, version, CONTAINER_VERSION);
  const length = view.getUint32(12, true);
  if (bytes.length < 16 + length) throw new ColumnsTruncated(where, bytes.length, 16 + length);
  let head: { bytes: unknown; kind: unknown; meta: unknown; columns: unknown };
  try {
    head = JSON.parse(new TextDecoder("utf-8", { fatal: true }).decode(bytes.subarray(16, 16 + length)));
  } catch {
    throw new ColumnsAltered(where, "its header is not readable");
  }
  const readable =
    head !== null && typeof head === "object" && isCount(head.bytes) && typeof head.kind === "string" &&
    head.meta !== null && typeof head.meta === "object" && Array.isArray(head.columns);
  if (!readable) throw new ColumnsAltered(where, "its header is not readable");
  const total = head.bytes as number;
  if (bytes.length < total) throw new ColumnsTruncated(where, bytes.length, total);
  if (bytes.length > total) throw new ColumnsAltered(where, "it is longer than its header says");
  const columns = new Map<string, Column>();
  for (const entry of head.columns as Record<string, unknown>[]) {
    const name = String(entry?.name);
    const { dtype, offset, shape } = (entry ?? {}) as { dtype: unknown; offset: unknown; shape: unknown };
    const valid =
      typeof dtype === "string" && Object.hasOwn(TYPES, dtype) && Array.isArray(shape) && shape.every(isCount) &&
      isCount(offset) && offset >= 16 + length && offset % 8 === 0;
    if (!valid) throw new ColumnsAltered(where, `column ${name} has an impossible type, shape or offset`);
    const make = TYPES[dtype as Dtype];
    const count = (shape as number[]).reduce((a, b) => a * b, 1);
    if (!Number.isSafeInteger(count) || offset + count * make.BYTES_PER_ELEMENT > total) {
      throw new ColumnsAltered(where, `column ${name} reaches past the end`);
    }
    const data = new make(bytes.buffer as ArrayBuffer, bytes.byteOffset + offset, count);
    columns.set(name, { dtype: dtype as Dtype, shape: shape as number[], data });
  }
  return { kind: head.kind as string, meta: head.meta as Record<string, unknown>, columns };
}

function isCount(n: unknown): n is number {
  return typeof n === "number" && Number.isSafeInteger(n) && n >= 0;
}

/** Takes typed columns out of a container and checks type and shape; a number of `shape` must match, null may be any. */
export class ColumnReader {
  constructor(
    readonly container: Container,
    readonly where: string,
  ) {}

  private take(name: string, dtype: Dtype, shape: (number | null)[]): ColumnArray {
    const column = this.container.columns.get(name);
    if (!column) throw new ColumnsAltered(this.where, `column ${name} is not there`);
    const fits =
      column.dtype === dtype && column.shape.length === shape.length &&
      shape.every((n, i) => n === null || n === column.shape[i]);
    if (!fits) {
      throw new ColumnsAltered(this.where, `column ${name} is ${column.dtype} (${column.shape.join(",")}), not as the format says`);
    }
    return column.data;
  }

  length(name: string): number {
    return this.container.columns.get(name)?.shape[0] ?? 0;
  }
  i1(name: string, ...shape: (number | null)[]): Int8Array {
    return this.take(name, "|i1", shape) as Int8Array;
  }
  u1(name: string, ...shape: (number | null)[]): Uint8Array {
    return this.take(name, "|u1", shape) as Uint8Array;
  }
  u2(name: string, ...shape: (number | null)[]): Uint16Array {
    return this.take(name, "<u2", shape) as Uint16Array;
  }
  i4(name: string, ...shape: (number | null)[]): Int32Array {
    return this.take(name, "<i4", shape) as Int32Array;
  }
  u4(name: string, ...shape: (number | null)[]): Uint32Array {
    return this.take(name, "<u4", shape) as Uint32Array;
  }
  f4(name: string, ...shape: (number | null)[]): Float32Array {
    return this.take(name, "<f4", shape) as Float32Array;
  }
  f8(name: string, ...shape: (number | null)[]): Float64Array {
    return this.take(name, "<f8", shape) as Float64Array;
  }

  /** Costs and bytes: int64 in the file, float64 here; exact, because values past 2^53 are refused. */
  i8(name: string, ...shape: (number | null)[]): Float64Array {
    const big = this.take(name, "<i8", shape) as BigInt64Array;
    const out = new Float64Array(big.length);
    for (let i = 0; i < out.length; i++) {
      out[i] = Number(big[i]);
      if (!Number.isSafeInteger(out[i])) throw new ColumnsAltered(this.where, `column ${name} holds ${big[i]}, past 2^53`);
    }
    return out;
  }

  /** A row column (CSR): begins at 0, does not fall, ends at `end`. */
  rows(name: string, rows: Int32Array, end: number): Int32Array {
    let ok = rows.length > 0 && rows[0] === 0 && rows[rows.length - 1] === end;
    for (let i = 1; ok && i < rows.length; i++) ok = rows[i] >= rows[i - 1];
    if (!ok) throw new ColumnsAltered(this.where, `column ${name} does not cut its ${end} entries`);
    return rows;
  }

  /** Ids within [low, high). */
  ids<T extends ArrayLike<number>>(name: string, ids: T, low: number, high: number): T {
    for (let i = 0; i < ids.length; i++) {
      if (!(ids[i] >= low && ids[i] < high)) throw new ColumnsAltered(this.where, `column ${name} holds ${ids[i]}, outside [${low}, ${high})`);
    }
    return ids;
  }
}

// Reads the test vectors as a program that knows MessagePack and nothing of cogradar, and writes them from their JSON.
// Prints the names of those that differ. Needs node --harmony-json-parse-with-source: JavaScript has one kind of number,
// and a float must stay a float.
import { readFileSync } from "node:fs";
import { deepStrictEqual } from "node:assert";
import { ExtData, decode, encode } from "@msgpack/msgpack";

class Float extends Number {}

const ELEMENTS = { i4: [4, "Int32"], f8: [8, "Float64"], c8: [4, "Float32"] };

function content(value) {
  if (value instanceof ExtData) {
    const view = new DataView(value.data.buffer, value.data.byteOffset, value.data.length);
    const dtype = String.fromCharCode(value.data[0], value.data[1]);
    const [size, name] = ELEMENTS[dtype];
    const shape = Array.from({ length: value.data[2] }, (_, i) => view.getUint32(3 + 4 * i, true));
    const values = [];
    for (let at = 3 + 4 * shape.length; at < view.byteLength; at += size) values.push(view[`get${name}`](at, true));
    return { dtype, shape, values };
  }
  if (value instanceof Uint8Array) return { base64: Buffer.from(value).toString("base64") };
  if (Array.isArray(value)) return value.map(content);
  if (value === null || typeof value !== "object") return value;
  return Object.fromEntries(Object.entries(value).map(([name, part]) => [name, content(part)]));
}

function plain(value) {
  if (value instanceof Float) return Number(value);
  if (Array.isArray(value)) return value.map(plain);
  if (value === null || typeof value !== "object") return value;
  return Object.fromEntries(Object.entries(value).map(([name, part]) => [name, plain(part)]));
}

function head(short, long, n) {
  return n < 16 ? Uint8Array.of(short + n) : Uint8Array.of(long, n >> 8, n & 255);
}

function written(value) {
  if (value instanceof Float) return encode(Number(value), { forceIntegerToFloat: true });
  if (Array.isArray(value)) return Buffer.concat([head(0x90, 0xdc, value.length), ...value.map(written)]);
  if (value === null || typeof value !== "object") return encode(value, { useBigInt64: true });
  if ("base64" in value) return encode(new Uint8Array(Buffer.from(value.base64, "base64")));
  if ("dtype" in value) {
    const { dtype, shape, values } = value;
    const [size, name] = ELEMENTS[dtype];
    const start = 3 + 4 * shape.length;
    const view = new DataView(new ArrayBuffer(start + size * values.length));
    [dtype.charCodeAt(0), dtype.charCodeAt(1), shape.length].forEach((byte, i) => view.setUint8(i, byte));
    shape.forEach((n, i) => view.setUint32(3 + 4 * i, n, true));
    values.forEach((one, i) => view[`set${name}`](start + size * i, Number(one), true));
    return encode(new ExtData(1, new Uint8Array(view.buffer)));
  }
  const parts = Object.entries(value).flatMap(([name, part]) => [encode(name), written(part)]);
  return Buffer.concat([head(0x80, 0xde, parts.length / 2), ...parts]);
}

function number(_, value, { source }) {
  if (typeof value !== "number") return value;
  if (/[.e]/.test(source)) return new Float(value);
  return value < 2 ** 32 ? value : BigInt(source);
}

let n = 0;
for (const line of readFileSync(process.argv[2], "utf8").trim().split("\n")) {
  const vector = JSON.parse(line, number);
  const bytes = Buffer.from(vector.bytes, "base64");
  n += 1;
  try {
    const read = content(decode(bytes, { useBigInt64: true }));
    const same = (one) => JSON.stringify(one, (_, part) => (typeof part === "bigint" ? Number(part) : part));
    deepStrictEqual(same(read), same(plain(vector.json)));
    deepStrictEqual(Buffer.from(written(vector.json)), bytes);
  } catch (error) {
    console.log(vector.name, error.message.slice(0, 400));
  }
}
console.log(n);

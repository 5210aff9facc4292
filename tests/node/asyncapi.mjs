// Reads AsyncAPI from standard input as AsyncAPI's own parser does; prints what it finds, and how many channels there are.
import { readFileSync } from "node:fs";
import { Parser } from "@asyncapi/parser";

const { document, diagnostics } = await new Parser().parse(readFileSync(0, "utf8"));
for (const { severity, code, path, message } of diagnostics) console.log(severity, code, path.join("."), message);
console.log(document === undefined ? "no document" : `${document.channels().all().length} channels`);

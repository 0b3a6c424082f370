// What the page asks of the workbench.

import { unpacked } from "./codec.js";

const PLACE = new URL("api/", document.baseURI);

// The workbench does not answer: it has ended, or it has moved to another address.
export class Unreachable extends Error {
  constructor(moved) {
    super(moved ? "The workbench was started again at another address" : "The workbench does not answer");
    this.moved = moved;
  }
}

// It answers, and says why not.
export class Refused extends Error {
  constructor(status, told, state) {
    super(told.message ?? `The workbench answered ${status}`);
    this.status = status;
    this.told = told;
    this.state = state;
  }
}

export const project = async () => (await ask("project")).json();

export const thumbnailUrl = (subject) => new URL(`${place(subject)}/thumbnail`, PLACE).href;

export async function picture(subject) {
  return createImageBitmap(await (await ask(`${place(subject)}/picture`)).blob());
}

// Has the picture made and kept by the browser before it is asked for.
export function fetchAhead(subject) {
  ask(`${place(subject)}/picture`, { priority: "low" }).then((answer) => answer.blob()).catch(() => {});
}

export async function mask(subject) {
  const answer = await ask(`${place(subject)}/mask`);
  return { state: stateOf(answer), data: await unpacked(await answer.arrayBuffer()) };
}

export async function saveMask(subject, bytes, role, version) {
  const headers = { "If-Match": version, "Content-Type": "application/gzip" };
  return (await ask(`${place(subject)}/mask?role=${role}`, { method: "PUT", headers, body: bytes })).json();
}

export async function removeMask(subject, version) {
  const headers = { "If-Match": version };
  return (await ask(`${place(subject)}/mask`, { method: "DELETE", headers })).json();
}

export async function objectIn(subject, rectangle) {
  const body = JSON.stringify({ rectangle });
  const answer = await ask(`${place(subject)}/rectangle`, { method: "POST", body });
  return unpacked(await answer.arrayBuffer());
}

export async function addressAt(port) {
  return (await (await ask("port", { method: "POST", body: JSON.stringify({ port }) })).json()).url;
}

function place(subject) {
  return `${subject.kind}/${encodeURIComponent(subject.name)}`;
}

function stateOf(answer) {
  const told = answer.headers.get("Mask-State");
  return told ? JSON.parse(told) : null;
}

async function ask(path, options = {}) {
  let answer;
  try {
    answer = await fetch(new URL(path, PLACE), options);
  } catch {
    throw new Unreachable(false);
  }
  // The token is refused: this is another run of the workbench than the page belongs to.
  if (answer.status === 403) throw new Unreachable(true);
  if (answer.ok) return answer;
  const told = await answer.json().catch(() => ({}));
  throw new Refused(answer.status, told, told.state ?? stateOf(answer));
}

// Plain words above the picture, with what can be done.

const lasting = document.querySelector("#notices");
const brief = document.querySelector("#brief");
const PASSING_MS = 6000;

// One notice per id; tone "calm" or "attention"; actions are [label, what it does] pairs, the
// first of them the one to prefer; command is something to type. A passing one lies over the picture and goes by itself.
export function say(id, { text, detail = "", command = "", tone = "calm", actions = [], passing = false }) {
  const notice = document.createElement("div");
  notice.className = `notice ${tone}`;
  notice.dataset.id = id;
  notice.setAttribute("role", tone === "attention" ? "alert" : "status");
  const words = document.createElement("p");
  const head = document.createElement("strong");
  head.textContent = text;
  words.append(head, detail && ` ${detail}`);
  if (command) {
    const code = document.createElement("code");
    code.textContent = command;
    words.append(" ", code);
  }
  notice.append(words);
  for (const [label, action] of actions) notice.append(button(label, action));
  if (!actions.length && !passing) notice.append(button("Close", () => notice.remove()));
  const before = lasting.querySelector(`[data-id="${id}"]`);
  if (before) before.replaceWith(notice);
  else (passing ? brief : lasting).append(notice);
  if (passing) setTimeout(() => notice.remove(), PASSING_MS);
}

export function unsay(id) {
  for (const place of [lasting, brief]) place.querySelector(`[data-id="${id}"]`)?.remove();
}

// An error of the workbench: what is wrong, what was found, what to do.
export function sayError(id, error, actions = []) {
  const { message = error.message, file, expected, found, fix } = error.told ?? {};
  const parts = [
    file && `File: ${file}.`,
    expected && `Expected: ${expected}.`,
    found && `Found: ${found}.`,
    fix && `What helps: ${fix}.`,
  ];
  say(id, { text: `${message}.`, detail: parts.filter(Boolean).join(" "), tone: "attention", actions });
}

function button(label, action) {
  const element = document.createElement("button");
  element.type = "button";
  element.textContent = label;
  element.addEventListener("click", action);
  return element;
}

// The mask editor: its parts brought together.

import * as api from "./api.js";
import { Controls } from "./controls.js";
import { Drafts, Orphans, forgetPort, otherPorts } from "./drafts.js";
import { Editor } from "./editor.js";
import { SubjectList } from "./list.js";
import { say, sayError, unsay } from "./notices.js";
import { Saver, keyOf } from "./saver.js";
import { Tools } from "./tools.js";
import { View } from "./view.js";

const LEAVING_MS = 200;

const at = (id) => document.querySelector(id);

async function start() {
  let project;
  try {
    project = await api.project();
  } catch (error) {
    return sayError("start", error);
  }
  document.title = `Masks – ${project.name}`;
  at("#project").textContent = project.name;
  at("#project").title = project.root;

  const drafts = await Drafts.open(project.identity).catch(() => null);
  const orphans = new Orphans(drafts);
  const saver = new Saver(drafts);
  const view = new View(at("#stage"));
  const tools = new Tools(view);
  const editor = new Editor(view, tools, saver, orphans);
  const list = new SubjectList(at("#list"), at("#filter"), at("#summary"));
  new Controls({ view, tools, editor, list, saver });

  const told = (subject) =>
    list.update(subject, Boolean(saver.status(subject)) || orphans.of(subject).length > 0);
  editor.addEventListener("told", (event) => event.detail && told(event.detail));
  list.addEventListener("chosen", (event) => open(event.detail));
  saver.addEventListener("reach", () => tellReach(project, saver));
  addEventListener("beforeunload", (event) => {
    if (editor.unkept || saver.holdsUnkept()) event.preventDefault();
  });
  // A page that is left or hidden may not come back: nothing waits then.
  document.addEventListener("visibilitychange", () => document.hidden && editor.keepNow());
  addEventListener("pagehide", () => editor.keepNow());

  async function open(subject) {
    list.select(subject);
    if (await editor.open(subject)) {
      history.replaceState(null, "", `#${encodeURI(keyOf(subject))}`);
      const next = list.shown[list.shown.indexOf(subject) + 1];
      if (next) api.fetchAhead(next);
    } else if (list.selected === subject && editor.subject) {
      list.select(editor.subject);
    }
  }

  async function lookForOrphans() {
    await orphans.look();
    project.subjects.forEach(told);
    tellOrphans(orphans, list, open);
  }

  list.show(project.subjects);
  await takeOver(project, editor, drafts, lookForOrphans);
  await lookForOrphans();
  tellProblems(project, drafts);
  tellOtherPorts(project);
  const wanted = decodeURI(location.hash.slice(1));
  const first = list.shown.find((subject) => keyOf(subject) === wanted) ?? list.shown[0];
  if (first) await open(first);
}

// Pages of this project that an earlier run of the workbench served keep what they have and
// leave the rest to this one.
async function takeOver(project, editor, drafts, onLeft) {
  const channel = new BroadcastChannel(`workbench-masks-${project.identity}`);
  const here = location.href.split("#")[0];
  channel.onmessage = async ({ data: { opened, left } }) => {
    if (left && left !== here) onLeft();
    if (!opened || opened === here || editor.ended) return;
    await editor.end();
    drafts?.leave();
    channel.postMessage({ left: here });
    channel.close();
    unsay("reach");
    say("ended", {
      tone: "attention",
      text: "The workbench was started again; this page has ended.",
      detail: "Nothing is lost: what was not saved is waiting in the new page.",
      actions: [["Go to the new page", () => location.assign(opened + location.hash)]],
    });
  };
  channel.postMessage({ opened: here });
  // Mostly enough for those pages to put away what they have; they tell when it was not.
  await new Promise((resolve) => setTimeout(resolve, LEAVING_MS));
}

function tellReach(project, saver) {
  if (saver.reachable) {
    unsay("reach");
    say("back", { text: "The workbench answers again.", detail: "Everything is being saved.", passing: true });
    return;
  }
  unsay("back");
  if (saver.moved) {
    say("reach", {
      tone: "attention",
      text: "The workbench was started again; this page has ended.",
      detail: saver.drafts
        ? "Nothing is lost: open the address it printed, and what was not saved is offered to you there."
        : "This browser keeps nothing: what was drawn since is in this page only.",
    });
    return;
  }
  const kept = saver.drafts
    ? "What you draw is kept in this browser, and will be saved or offered to you when it runs again:"
    : "This browser keeps nothing, so do not close this page. Start it again:";
  say("reach", {
    tone: "attention",
    text: "The workbench has stopped.",
    detail: kept,
    command: `workbench edit-masks ${project.root}`,
  });
}

function tellProblems(project, drafts) {
  project.problems.forEach((told, k) => sayError(`problem-${k}`, { told }));
  if (project.scans_unknown) {
    say("scans", {
      text: "The scans are not listed yet.",
      detail: "They appear here after:",
      command: `workbench ingest ${project.root}`,
    });
  }
  if (!drafts) {
    say("drafts", {
      tone: "attention",
      text: "This browser keeps no drawings.",
      detail: "Should the workbench stop, what is not saved then would be lost. A private window may be the reason.",
    });
  }
}

function tellOrphans(orphans, list, open) {
  const waiting = list.shown.filter((subject) => orphans.of(subject).length);
  if (!waiting.length) return;
  const many = waiting.length > 1 ? `${waiting.length} drawings` : "A drawing";
  say("orphans", {
    tone: "attention",
    text: `${many} from before ${waiting.length > 1 ? "were" : "was"} not saved; this browser kept ${waiting.length > 1 ? "them" : "it"}.`,
    detail: waiting.map((subject) => subject.name).slice(0, 6).join(", ") + (waiting.length > 6 ? " …" : ""),
    actions: [
      [waiting.length > 1 ? "Look at the first" : "Look at it", () => { unsay("orphans"); open(waiting[0]); }],
      ["Later", () => unsay("orphans")],
    ],
  });
}

function tellOtherPorts(project) {
  const [port] = otherPorts(project.identity);
  if (!port) return;
  say("port", {
    tone: "attention",
    text: "There may be unsaved drawings from when this page had another address.",
    detail: `This browser keeps them under port ${port}.`,
    actions: [
      ["Go there", () => goTo(project, port)],
      ["Later", () => unsay("port")],
    ],
  });
}

async function goTo(project, port) {
  try {
    location.assign((await api.addressAt(Number(port))) + location.hash);
  } catch (error) {
    sayError("port", error, [
      ["Close", () => unsay("port")],
      ["Forget them", () => { forgetPort(project.identity, port); unsay("port"); }],
    ]);
  }
}

start();

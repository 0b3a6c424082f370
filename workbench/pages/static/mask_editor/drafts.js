// Drawings the workbench has not confirmed yet, kept by the browser until it has.
//
// They are kept per project, subject and page; those of pages that are gone are offered for
// recovery. A browser keeps a store per port, so a cookie, which all ports share, remembers
// the ports whose stores hold something.

const DATABASE = "workbench-masks";
const STORE = "drafts";

export class Drafts {
  static async open(project) {
    const page = crypto.randomUUID();
    const release = await heldLock(lockName(page));
    const database = await new Promise((resolve, reject) => {
      const request = indexedDB.open(DATABASE, 1);
      request.onupgradeneeded = () =>
        request.result.createObjectStore(STORE, { keyPath: ["project", "kind", "name", "page"] });
      request.onsuccess = () => resolve(request.result);
      request.onerror = () => reject(request.error);
    });
    return new Drafts(database, project, page, release);
  }

  constructor(database, project, page, release) {
    this.database = database;
    this.project = project;
    this.page = page;
    // After this others may take over what this page drew.
    this.leave = release;
  }

  // bytes: the packed mask; version: of the mask on disk that it was drawn over.
  async put(subject, bytes, role, version) {
    const { kind, name } = subject;
    const draft = { project: this.project, page: this.page, kind, name, bytes, role, version };
    await this.#request("readwrite", (store) => store.put({ ...draft, time: Date.now() }));
    notePort(this.project, true);
  }

  async remove({ kind, name, page = this.page }) {
    await this.#request("readwrite", (store) => store.delete([this.project, kind, name, page]));
    notePort(this.project, (await this.all()).length > 0);
  }

  async all() {
    const everything = await this.#request("readonly", (store) => store.getAll());
    return everything.filter((draft) => draft.project === this.project);
  }

  #request(mode, ask) {
    return new Promise((resolve, reject) => {
      const transaction = this.database.transaction(STORE, mode, { durability: "strict" });
      const request = ask(transaction.objectStore(STORE));
      transaction.oncomplete = () => resolve(request.result);
      transaction.onabort = transaction.onerror = () => reject(transaction.error);
    });
  }
}

// Drafts of pages that are gone, the newest first.
export class Orphans {
  constructor(drafts) {
    this.drafts = drafts;
    this.found = [];
  }

  async look() {
    if (!this.drafts) return;
    const alive = new Set((await navigator.locks.query()).held.map((lock) => lock.name));
    this.found = (await this.drafts.all())
      .filter((draft) => !alive.has(lockName(draft.page)))
      .sort((a, b) => b.time - a.time);
  }

  of({ kind, name }) {
    return this.found.filter((draft) => draft.kind === kind && draft.name === name);
  }

  async remove(draft) {
    this.found = this.found.filter((each) => each !== draft);
    await this.drafts.remove(draft);
  }
}

// Other ports under which this browser keeps drawings of the project.
export function otherPorts(project) {
  return notedPorts(project).filter((port) => port !== location.port);
}

export function forgetPort(project, port) {
  writePorts(project, notedPorts(project).filter((each) => each !== port));
}

function notePort(project, holdsDrafts) {
  const others = otherPorts(project);
  writePorts(project, holdsDrafts ? [...others, location.port] : others);
}

const cookieName = (project) => `workbench-drafts-${project}`;

function notedPorts(project) {
  const start = `${cookieName(project)}=`;
  const cookie = document.cookie.split("; ").find((each) => each.startsWith(start));
  return cookie ? cookie.slice(start.length).split(".").filter(Boolean) : [];
}

function writePorts(project, ports) {
  const age = ports.length ? 400 * 24 * 3600 : 0;
  document.cookie = `${cookieName(project)}=${ports.join(".")}; path=/; max-age=${age}; SameSite=Strict`;
}

const lockName = (page) => `workbench-page-${page}`;

// Holds a lock as long as the page lives, or until the function it gives is called.
function heldLock(name) {
  return new Promise((resolve) => {
    navigator.locks.request(name, () => new Promise((release) => resolve(release)));
  });
}

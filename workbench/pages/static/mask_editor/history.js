// What can be undone and redone of one mask. A change is its own inverse (see Mask.turnOver).

const MOST_CHANGES = 300;
const MOST_RUNS = 16e6;

export class History {
  constructor() {
    this.done = [];
    this.undone = [];
  }

  push(change) {
    this.done.push(change);
    this.undone = [];
    let runs = this.done.reduce((sum, each) => sum + each.runs.length, 0);
    while (this.done.length > MOST_CHANGES || (runs > MOST_RUNS && this.done.length > 1)) {
      runs -= this.done.shift().runs.length;
    }
  }

  undo(mask) {
    return move(this.done, this.undone, mask);
  }

  redo(mask) {
    return move(this.undone, this.done, mask);
  }
}

function move(from, to, mask) {
  const change = from.pop();
  if (!change) return false;
  mask.turnOver(change);
  to.push(change);
  return true;
}

// Functions that are called for events, any number for each.

/** @template M what is told with each event, by its name */
export class Listeners {
  /** @type {Map<keyof M, Set<(what: any) => void>>} */
  #all = new Map();

  /**
   * Calls the listener for every event of this name from now on; returns a function that ends this.
   * @template {keyof M} E
   * @param {E} event
   * @param {(what: M[E]) => void} listener
   * @returns {() => void}
   */
  on(event, listener) {
    const all = this.#all.get(event) ?? new Set();
    this.#all.set(event, all.add(listener));
    return () => void all.delete(listener);
  }

  /**
   * @template {keyof M} E
   * @param {E} event
   * @param {M[E]} what
   */
  emit(event, what) {
    for (const listener of [...(this.#all.get(event) ?? [])]) listener(what);
  }
}

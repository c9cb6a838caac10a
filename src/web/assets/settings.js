// Choices of the person that outlive a reload: the browser keeps them for this address.

/** Returns a choice that was kept, or `otherwise`. */
export function kept(name, otherwise) {
  try {
    return JSON.parse(localStorage.getItem(name)) ?? otherwise;
  } catch {
    return otherwise;
  }
}

/** Keeps a choice, unless the browser keeps nothing. */
export function keep(name, value) {
  try {
    localStorage.setItem(name, JSON.stringify(value));
  } catch {
    // A private window may keep nothing; the choice then holds until the reload.
  }
}

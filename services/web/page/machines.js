// The machine room.
export class Machines {
  watch() {}
}

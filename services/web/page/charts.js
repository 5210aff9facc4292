// The charts beside the scope. Their library comes when the first picture is there: it is large, and the scope can wait for nothing.
export class Charts {
  show() {}
}

// Makes view.html, one file with everything in it: `npm ci && npm run build`. The result is committed, so building
// occlude needs no npm.
import { build } from 'esbuild';
import { readFileSync, writeFileSync } from 'node:fs';

const bundled = await build({
  entryPoints: ['view.js'], bundle: true, minify: true, write: false, format: 'iife', target: 'es2020', legalComments: 'none',
});
const licence = readFileSync('node_modules/three/LICENSE', 'utf8').trim();
// A closing tag inside of a script would end it.
const script = bundled.outputFiles[0].text.replaceAll('</script', '<\\/script');
const page = readFileSync('page.html', 'utf8')
  .replace('@LICENCE@', () => licence)
  .replace('@SCRIPT@', () => script);
writeFileSync('view.html', page);
console.log(`view.html: ${page.length} bytes`);
